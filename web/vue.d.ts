// <ssplat-img> in templates of Vue: "types": ["ssplat/vue"] in tsconfig.json, or /// <reference types="ssplat/vue" />
import type { DefineComponent, HTMLAttributes } from "vue"
import type { SsplatImgAttributes } from "./ssplat-img.js"

declare module "vue" {
  interface GlobalComponents {
    "ssplat-img": DefineComponent<HTMLAttributes & SsplatImgAttributes>
  }
}
