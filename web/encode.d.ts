/** An error of the encoder. */
export class SsplatError extends Error {
  /**
   * parameter: a wrong argument or option; size: the file that was asked for is too small for the picture; limit: the encode needs more
   * memory than `limits.alloc`; network: the module could not be fetched; internal: the encoder failed.
   */
  readonly kind: "parameter" | "size" | "limit" | "network" | "internal"
}

/** Pixels, rows from the top, channels interleaved. ImageData is one. */
export interface EncodePixels {
  width: number
  height: number
  /** Samples of 8 or 16 bits: 1 to 4 for each pixel (grey, grey and alpha, RGB, RGBA; alpha is not premultiplied). */
  data: Uint8Array | Uint8ClampedArray | Uint16Array
  /** Samples of a pixel; without it, what the length of `data` gives. */
  channels?: 1 | 2 | 3 | 4
}

/** What a file is to be. Of `ratio`, `bytes`, `psnr`, `quality` and `primitives` one can be given; without one the ratio is 50. */
export interface EncodeOptions {
  /** Bytes of the samples over bytes of the file. */
  ratio?: number
  /** Most bytes of the file. */
  bytes?: number
  /** Least PSNR, dB. */
  psnr?: number
  /** Least SSIMULACRA2: 30 low, 50 medium, 70 high, 90 very high. */
  quality?: number
  /** Number of Gaussians. */
  primitives?: number
  /** 1 to 9, by default 5: how much work to spend. */
  effort?: number
  /** The measure to favour, by default "iq", as eyes see it, and "psnr" where a PSNR is asked for. */
  tune?: "psnr" | "ssim" | "iq"
  /** Seconds that the encode may take; the best state reached is the result, which then differs from machine to machine. */
  time?: number
  seed?: number
  /** Whether the file has a detail layer where it pays. */
  detail?: "auto" | "off"
  /** 1 to 8 progressive levels. */
  levels?: number
  /** ICC profile to carry; without one pixels are sRGB. */
  icc?: Uint8Array | ArrayBuffer
  /** EXIF block to carry, from its TIFF header on. */
  exif?: Uint8Array | ArrayBuffer
  /** How the picture is to be turned, 1 to 8 as in EXIF, to be carried. Pixels are not turned. */
  orientation?: number
  /** `alloc`: most bytes of WebAssembly's memory, by default 1 GiB, at most 4 GiB. */
  limits?: { alloc?: number }
  /** Whether to encode in a worker of its own; by default true. In browsers, a function that starts `encode-worker.js` as a module. */
  worker?: boolean | (() => Worker)
  /** The WebAssembly as a URL, bytes or a compiled module, if it is not that of the package. */
  module?: string | URL | ArrayBuffer | Uint8Array | WebAssembly.Module
  /** Stops the encode: at once in a worker, otherwise when `onProgress` aborts it. The promise is rejected with the signal's reason. */
  signal?: AbortSignal
  /** Is told the stage and the share of it that is done, 0 to 1. What it throws stops the encode. */
  onProgress?: (stage: string, done: number) => void
}

export interface EncodeReport {
  /** Number of Gaussians. */
  primitives: number
  /** dB, over the samples as a decoder writes them; Infinity if all are equal. */
  psnr: number
  /** SSIMULACRA2, where it was asked for. */
  quality?: number
  seconds: number
  stages: { name: string; seconds: number }[]
  /** What the encoder left out because the picture does not need it, and the bytes that this saved. */
  leftOut: { what: string; bytes: number }[]
}

/** Encodes pixels to an .ssplat file: the same bytes as the program's. Several calls run at a time, each in its own worker. */
export function encode(pixels: EncodePixels, options?: EncodeOptions): Promise<{ bytes: Uint8Array; report: EncodeReport }>

/**
 * Computes the SSIMULACRA2 score of `test` against `reference`, two pictures of the same size, channels and depth: at most 100, for
 * identical pictures; 90 very high, 70 high, 50 medium, 30 low quality. NaN if a side has fewer than 8 pixels.
 */
export function ssimulacra2(reference: EncodePixels, test: EncodePixels, options?: Pick<EncodeOptions, "limits" | "worker" | "module" | "signal">): Promise<number>

/** Fetches and compiles the WebAssembly before it is needed. */
export function preload(): Promise<void>
