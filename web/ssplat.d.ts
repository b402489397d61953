/** What went wrong, in the decoder's words. */
export class SsplatError extends Error {
  /**
   * format: a broken file; version: a newer file; limit: sound but too large; parameter: a wrong argument; network: a file could not
   * be fetched; internal: the decoder failed.
   */
  readonly kind: "format" | "version" | "limit" | "parameter" | "network" | "internal"
}

/** What a file may ask for; the defaults are the Rust crate's. */
export interface Limits {
  /** Pixels. */
  width?: number
  /** Pixels. */
  height?: number
  primitives?: number
  tilePairs?: number
  work?: number
  overlap?: number
  /** Bytes of memory in all. */
  alloc?: number
  /** Bytes of ICC profile, EXIF block and other sections. */
  metadata?: number
}

export interface DecodeOptions {
  /** Part of the picture in its own pixels: left, top, width, height. */
  region?: [number, number, number, number] | { left: number; top: number; width: number; height: number }
  /** Columns of the output, at least 1; without it one for each of the part. */
  width?: number
  /** Rows of the output, at least 1, beside a width; without it the part's shape is kept. */
  height?: number
  /** Draws what is there of a damaged or cut file that has groups. */
  partial?: boolean
  /** Whether the detail layer is drawn: with the Gaussians, not at all, or on grey without them. */
  detail?: "on" | "off" | "alone"
  /**
   * Memory of a former answer (`image.data.buffer`) that the pixels go into if they fit: new memory takes a part of the time of a large
   * picture. A worker takes it away (it is detached) and gives it back with its answer.
   */
  into?: ArrayBuffer
  limits?: Limits
}

export interface Header {
  /** Pixels, before `orientation` turns them. */
  width: number
  height: number
  /** 1 grey, 2 grey and alpha, 3 colour, 4 colour and alpha. */
  channels: 1 | 2 | 3 | 4
  /** Bits a sample of the source. */
  depth: 8 | 16
  primitives: number
  /** 1 to 8 as EXIF counts them; `decode` does not turn. */
  orientation: number
  /** The picture as a smaller file; empty if there is none. */
  thumbnail: Uint8Array
  /** Empty if there is none. */
  icc: Uint8Array
  /** Empty if there is none. */
  exif: Uint8Array
}

/** RGBA with 8 bits. Where there is no ImageData (Node.js) an object with its fields. */
export type Pixels = ImageData & {
  channels: 1 | 2 | 3 | 4
  depth: 8 | 16
  primitives: number
  orientation: number
  icc: Uint8Array
  exif: Uint8Array
  /** Primitives that `partial` could not read. */
  missing: number
  /** Tiles of the detail layer that `partial` could not read. */
  missingTiles: number
  /** Whether the file is cut off or its checksum does not match; only `partial` decodes such a file. */
  damaged: boolean
}

export interface Gaussians {
  /** Pixels of the picture. */
  width: number
  height: number
  channels: 1 | 2 | 3 | 4
  count: number
  /** Centres: x and y of each, pixels. */
  mean: Float32Array
  /** Standard deviations along the major and the minor axis of each, pixels. */
  scale: Float32Array
  /** Direction of the major axis of each, radians. */
  rotation: Float32Array
  /** Four of each, from 0 for black to 1 for white; unused ones are 0. */
  color: Float32Array
  /** Four. */
  background: Float32Array
}

export interface Info {
  version: number
  width: number
  height: number
  channels: 1 | 2 | 3 | 4
  depth: 8 | 16
  primitives: number
  groups: number
  /** Colours in the codebook; 0 without one. */
  codebook: number
  bytes: number
  layout: "packed" | "planes" | "coded"
  blend: "sum" | "normalized"
  /** Bytes of the detail layer; 0 without one. */
  detail: number
  /** Primitives of each progressive level. */
  levels: number[]
  /** Bytes of each part of the file. */
  parts: { name: string; bytes: number }[]
  sections: { name: string; bytes: number }[]
  /** Bits of each field over all primitives. */
  fields: { name: string; bits: number }[]
  /** Bits of each Gaussian, in the order of `gaussians`; empty in layouts that give all as many. */
  each: Float32Array
  orientation: number
  icc: Uint8Array
  exif: Uint8Array
}

type Bytes = Uint8Array | ArrayBuffer
/** The WebAssembly: where it is, what was fetched, its bytes, or compiled. */
type Source = URL | string | Response | ArrayBuffer | Uint8Array | WebAssembly.Module

export interface DecoderOptions {
  /** Decode beside the page. Where there are no workers, or none may start, the calling thread decodes. */
  worker?: boolean
  /** The WebAssembly, if it is not that of the package. */
  module?: Source
}

/** Draws and describes files. */
export class Decoder {
  /** Throws a SsplatError of the kind "parameter" for an option that there is not. */
  constructor(options?: DecoderOptions)
  /** Rejects with a SsplatError, as all of these do. */
  decode(bytes: Bytes, options?: DecodeOptions): Promise<Pixels>
  header(bytes: Bytes, options?: { limits?: Limits }): Promise<Header>
  gaussians(bytes: Bytes, options?: { limits?: Limits }): Promise<Gaussians>
  info(bytes: Bytes, options?: { limits?: Limits }): Promise<Info>
  /** Ends the worker; what was asked and not answered fails. */
  close(): void
}

/** Draws a file in this thread. */
export function decode(bytes: Bytes, options?: DecodeOptions): Promise<Pixels>
export function header(bytes: Bytes, options?: { limits?: Limits }): Promise<Header>
export function gaussians(bytes: Bytes, options?: { limits?: Limits }): Promise<Gaussians>
export function info(bytes: Bytes, options?: { limits?: Limits }): Promise<Info>
/** Compiles the WebAssembly, to be given to several decoders. */
export function compile(source?: Source): Promise<WebAssembly.Module>
/** The canvas's colour space for an ICC profile. */
export function colorSpace(icc?: Uint8Array): "srgb" | "display-p3"
