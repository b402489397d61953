/** An `<img>` for .ssplat files, and for what else the browser knows. Its `error` event is an ErrorEvent whose `error` is a SsplatError. */
export class SsplatImg extends HTMLElement {
  /** As those of `<img>`. */
  src: string
  alt: string
  loading: "lazy" | "eager"
  /** The attributes; read, the size in CSS pixels at which the element is shown. */
  width: number
  height: number
  /** A small .ssplat file as base64 or data URI, which is shown until the picture is there. */
  placeholder: string
  readonly naturalWidth: number
  readonly naturalHeight: number
  readonly complete: boolean
  /** The address that is shown or on its way; empty without one. */
  readonly currentSrc: string
  /** Waits until the picture is there; rejects with a SsplatError. */
  decode(): Promise<void>
}

declare global {
  interface HTMLElementTagNameMap {
    "ssplat-img": SsplatImg
  }
}
