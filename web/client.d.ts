// Types of the imports that the plugins serve: /// <reference types="ssplat/client" />
// TypeScript knows a module by the end of its name: with options, `ssplat` comes last, as in "./photo.jpg?quality=70&ssplat".

interface SsplatPicture {
  /** The URL of the .ssplat file. */
  src: string
  /** Pixels of the picture, upright. */
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
