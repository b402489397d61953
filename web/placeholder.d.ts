/** What went wrong. */
export class SsplatError extends Error {
  /** format: a broken file; version: a newer file; limit: sound but too large; unsupported: a sound file of another kind; parameter: a wrong size. */
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

/** The Gaussians of a file. Throws a SsplatError. */
export function read(bytes: Uint8Array): Picture
/**
 * Draws a file, `width` and `height` pixels large, both at least 1: without a width in its own size, without a height in its shape.
 * At most 2²⁴ pixels are drawn, and 2²⁰ where the file has a say in the size. Throws a SsplatError.
 */
export function decode(bytes: Uint8Array, width?: number, height?: number): Drawn
