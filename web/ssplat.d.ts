/** An error of the decoder, with its message. */
export class SsplatError extends Error {
  /**
   * format: a broken file; version: a file of an unsupported version; limit: valid but too large; parameter: a wrong argument; network: a file could not
   * be fetched; internal: the decoder failed.
   */
  readonly kind: "format" | "version" | "limit" | "parameter" | "network" | "internal"
}

/** Limits for a file; the defaults are those of the Rust crate. */
export interface Limits {
  /** Pixels. */
  width?: number
  /** Pixels. */
  height?: number
  gaussians?: number
  tilePairs?: number
  work?: number
  overlap?: number
  /** Total memory, bytes. */
  alloc?: number
  /** Bytes of ICC profile, EXIF block and other sections. */
  metadata?: number
}

export interface DecodeOptions {
  /** Part of the picture, in pixels of the picture: left, top, width, height. */
  region?: [number, number, number, number] | { left: number; top: number; width: number; height: number }
  /** Width of the output, at least 1. Without width and height, the output has the size of the part. */
  width?: number
  /** Height of the output, at least 1. If only one of width and height is given, the aspect ratio is kept. */
  height?: number
  /** Renders the intact parts of a damaged or truncated file. */
  partial?: boolean
  /** Which layers are rendered: all of them, the Gaussians alone, or the detail layer alone on grey. */
  detail?: "on" | "off" | "alone"
  /**
   * Memory of an earlier result (`image.data.buffer`), which is reused if it is large enough. This saves time for large pictures, because
   * allocating memory takes time. A worker detaches the buffer and returns it with the result.
   */
  into?: ArrayBuffer
  limits?: Limits
}

export interface Header {
  /** Pixels, before `orientation` is applied. */
  width: number
  height: number
  /** 1 grey, 2 grey and alpha, 3 colour, 4 colour and alpha. */
  channels: 1 | 2 | 3 | 4
  /** Bits per sample of the source. */
  depth: 8 | 16
  gaussians: number
  /** EXIF orientation, 1 to 8; `decode` does not apply it. */
  orientation: number
  /** The thumbnail as a file; empty if there is none. */
  thumbnail: Uint8Array
  /** Code points by ITU-T H.273: primaries, transfer characteristics, 0, and 1 for full range. Empty if there are none. They take precedence over `icc`. */
  cicp: Uint8Array
  /** Empty if there is none. */
  icc: Uint8Array
  /** Empty if there is none. */
  exif: Uint8Array
}

/** RGBA with 8 bits. Without ImageData (Node.js), an object with the same fields. */
export type Pixels = ImageData & {
  channels: 1 | 2 | 3 | 4
  depth: 8 | 16
  gaussians: number
  orientation: number
  cicp: Uint8Array
  icc: Uint8Array
  exif: Uint8Array
  /** Gaussians that `partial` could not read. */
  missing: number
  /** Tiles of the detail layer that `partial` could not read. */
  missingTiles: number
  /** Whether the file is truncated or its checksum does not match; such files are decoded only with `partial`. */
  damaged: boolean
}

/** JavaScript, Rust and Python have the values of a Gaussian in the same order and units: mean, scale, rotation, color. */
export interface Gaussians {
  /** Pixels of the picture. */
  width: number
  height: number
  channels: 1 | 2 | 3 | 4
  count: number
  /** Centres: x and y of each, pixels; the centre of the first pixel is at (0.5, 0.5). */
  mean: Float32Array
  /** Standard deviations along the major and the minor axis of each, pixels. */
  scale: Float32Array
  /** Direction of the major axis of each, radians, from x towards y. */
  rotation: Float32Array
  /** Four encoded sRGB values per Gaussian, from 0 for black to 1 for white; unused ones are 0. */
  color: Float32Array
  /** Four values, as in `color`. */
  background: Float32Array
}

export interface Info {
  version: number
  width: number
  height: number
  channels: 1 | 2 | 3 | 4
  depth: 8 | 16
  gaussians: number
  groups: number
  /** Colours in the codebook; 0 without one. */
  codebook: number
  bytes: number
  layout: "packed" | "planes" | "coded"
  blend: "sum" | "normalized"
  /** Bytes of the detail layer; 0 without one. */
  detail: number
  /** Bytes of the exact layer; 0 without one. */
  exact: number
  /** Gaussians of each progressive level. */
  levels: number[]
  /** Bytes of each part of the file. */
  parts: { name: string; bytes: number }[]
  sections: { name: string; bytes: number }[]
  /** Bits of each field over all Gaussians. */
  fields: { name: string; bits: number }[]
  /** Bits of each Gaussian, in the order of `gaussians`; empty in layouts where all have the same size. */
  each: Float32Array
  /** Which cells of 8 × 8 pixels the exact layer covers, row by row: 1 or 0 each; empty without an exact layer. */
  cells: Uint8Array
  orientation: number
  cicp: Uint8Array
  icc: Uint8Array
  exif: Uint8Array
}

type Bytes = Uint8Array | ArrayBuffer
/** The WebAssembly: its URL, a Response, its bytes, or a compiled module. */
type Source = URL | string | Response | ArrayBuffer | Uint8Array | WebAssembly.Module

export interface DecoderOptions {
  /** Whether to decode in a worker. If no worker can start, the calling thread decodes. */
  worker?: boolean
  /** The WebAssembly, if it is not that of the package. */
  module?: Source
}

/** Decodes files and returns their properties. */
export class Decoder {
  /** Throws a SsplatError of the kind "parameter" if an option does not exist. */
  constructor(options?: DecoderOptions)
  /** Rejects with a SsplatError, like all of these methods. */
  decode(bytes: Bytes, options?: DecodeOptions): Promise<Pixels>
  header(bytes: Bytes, options?: { limits?: Limits }): Promise<Header>
  gaussians(bytes: Bytes, options?: { limits?: Limits }): Promise<Gaussians>
  info(bytes: Bytes, options?: { limits?: Limits }): Promise<Info>
  /** Ends the worker; pending requests fail. */
  close(): void
}

/** Decodes a file in this thread. */
export function decode(bytes: Bytes, options?: DecodeOptions): Promise<Pixels>
export function header(bytes: Bytes, options?: { limits?: Limits }): Promise<Header>
export function gaussians(bytes: Bytes, options?: { limits?: Limits }): Promise<Gaussians>
export function info(bytes: Bytes, options?: { limits?: Limits }): Promise<Info>
/** Compiles the WebAssembly, so that several decoders can share it. */
export function compile(source?: Source): Promise<WebAssembly.Module>
/** Returns the canvas colour space for an ICC profile and code points, which take precedence. */
export function colorSpace(icc?: Uint8Array, cicp?: Uint8Array): "srgb" | "display-p3"
