/** An error of the decoder. */
export class SsplatError extends Error {
  /** format: a broken file; version: a file of an unsupported version; limit: valid but too large; unsupported: a valid file of another kind; parameter: an invalid size. */
  readonly kind: "format" | "version" | "limit" | "unsupported" | "parameter"
}

/**
 * Centre x and y, and the standard deviations along the major and the minor axis, in pixels; direction of the major axis in radians;
 * one to four channels, from 0 for black to 1 for white.
 */
export type Gaussian = [x: number, y: number, major: number, minor: number, rotation: number, color: number[]]

export interface Picture {
  /** Pixels. */
  width: number
  height: number
  channels: 1 | 2 | 3 | 4
  blend: "sum" | "normalized"
  gaussians: Gaussian[]
  background: number[]
}

export interface Drawn {
  /** Pixels. */
  width: number
  height: number
  /** RGBA with 8 bits. */
  rgba: Uint8ClampedArray<ArrayBuffer>
  picture: Picture
}

/** Returns the Gaussians of a file. Throws a SsplatError. */
export function read(bytes: Uint8Array): Picture
/**
 * Renders a file with `width` × `height` pixels, both at least 1. The default width is that of the picture; the default height keeps its
 * aspect ratio.
 * At most 2²⁴ pixels are rendered, and at most 2²⁰ unless both sides are given. Throws a SsplatError.
 */
export function decode(bytes: Uint8Array, width?: number, height?: number): Drawn
