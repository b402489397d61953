// <ssplat-img> in JSX of React, and of Next.js, Remix and others that use it: "types": ["ssplat/react"] in tsconfig.json, or /// <reference types="ssplat/react" />
import type { DetailedHTMLProps, HTMLAttributes } from "react"
import type { SsplatImg, SsplatImgAttributes } from "./ssplat-img.js"

declare module "react" {
  namespace JSX {
    interface IntrinsicElements {
      "ssplat-img": DetailedHTMLProps<HTMLAttributes<SsplatImg>, SsplatImg> & SsplatImgAttributes
    }
  }
}
