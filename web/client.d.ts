// Types of the imports that the plugins handle: /// <reference types="ssplat/client" />
// TypeScript recognizes these modules by the end of their name, so `ssplat` must come last, as in "./photo.jpg?quality=70&ssplat".

interface SsplatPicture {
  /** The URL of the .ssplat file. */
  src: string
  /** Size of the picture after its orientation has been applied, pixels. */
  width: number
  height: number
  /** A small .ssplat file as a data URI, for the attribute `placeholder` of `<ssplat-img>`; empty with `placeholder=0`. */
  placeholder: string
}

declare module "*?ssplat" {
  const picture: SsplatPicture
  export default picture
}

declare module "*&ssplat" {
  const picture: SsplatPicture
  export default picture
}
