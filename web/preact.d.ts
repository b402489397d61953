// <ssplat-img> in JSX of Preact: "types": ["ssplat/preact"] in tsconfig.json, or /// <reference types="ssplat/preact" />
import type { HTMLAttributes } from "preact"
import type { SsplatImg, SsplatImgAttributes } from "./ssplat-img.js"

declare module "preact" {
  namespace JSX {
    interface IntrinsicElements {
      "ssplat-img": HTMLAttributes<SsplatImg> & SsplatImgAttributes
    }
  }
}
