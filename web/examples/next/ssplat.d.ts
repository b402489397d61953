/// <reference types="ssplat/client" />
// The element in JSX.
import type { DetailedHTMLProps, HTMLAttributes } from "react"
import type { SsplatImg } from "ssplat/ssplat-img.js"

declare module "react" {
  namespace JSX {
    interface IntrinsicElements {
      "ssplat-img": DetailedHTMLProps<HTMLAttributes<SsplatImg>, SsplatImg> & { src: string, alt: string, placeholder?: string, loading?: "lazy" | "eager" }
    }
  }
}
