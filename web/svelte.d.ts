// <ssplat-img> in templates of Svelte: "types": ["ssplat/svelte"] in tsconfig.json, or /// <reference types="ssplat/svelte" />
import type { HTMLAttributes } from "svelte/elements"
import type { SsplatImg, SsplatImgAttributes } from "./ssplat-img.js"

declare module "svelte/elements" {
  interface SvelteHTMLElements {
    "ssplat-img": HTMLAttributes<SsplatImg> & SsplatImgAttributes
  }
}
