/** An `<img>` for .ssplat files and for all pictures that the browser supports. Its `error` event is an ErrorEvent whose `error` is a SsplatError. */
export class SsplatImg extends HTMLElement {
  /** Like those of `<img>`. */
  src: string
  alt: string
  loading: "lazy" | "eager"
  /** Set the attributes; reading returns the size of the element in CSS pixels. */
  width: number
  height: number
  /** A small .ssplat file as base64 or data URI, which is shown until the picture has loaded. */
  placeholder: string
  readonly naturalWidth: number
  readonly naturalHeight: number
  readonly complete: boolean
  /** The address of the picture that is shown or loading; empty if there is none. */
  readonly currentSrc: string
  /** Waits until the picture has loaded; rejects with a SsplatError. */
  decode(): Promise<void>
}

/** The attributes of `<ssplat-img>`, for the types of frameworks. */
export interface SsplatImgAttributes {
  src?: string
  alt?: string
  loading?: "lazy" | "eager"
  /** CSS pixels. */
  width?: number | string
  /** CSS pixels. */
  height?: number | string
  placeholder?: string
}

declare global {
  interface HTMLElementTagNameMap {
    "ssplat-img": SsplatImg
  }
}
