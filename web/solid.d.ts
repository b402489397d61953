// <ssplat-img> in JSX of Solid: "types": ["ssplat/solid"] in tsconfig.json, or /// <reference types="ssplat/solid" />
import type { JSX } from "solid-js"
import type { SsplatImg, SsplatImgAttributes } from "./ssplat-img.js"

declare module "solid-js" {
  namespace JSX {
    interface IntrinsicElements {
      "ssplat-img": HTMLAttributes<SsplatImg> & SsplatImgAttributes
    }
  }
}
