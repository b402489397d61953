/** @jsxImportSource preact */
/// <reference types="ssplat/preact" />
import photo from "./photo.jpg?ssplat"

export const right = <ssplat-img {...photo} alt="A lighthouse" loading="lazy" id="photo" style={{ width: "50%" }} />
// @ts-expect-error
export const wrongLoading = <ssplat-img src="photo.ssplat" loading="early" />
// @ts-expect-error
export const wrongAttribute = <ssplat-img sources="photo.ssplat" />
