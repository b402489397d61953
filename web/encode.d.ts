/** An error of the encoder. */
export class SsplatError extends Error {
  /**
   * parameter: a wrong argument or option; size: the requested file is too small for the picture; limit: the encode needs more
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
  /** Samples per pixel; by default derived from the length of `data`. */
  channels?: 1 | 2 | 3 | 4
}

/** Options of an encode. At most one of `ratio`, `bytes`, `psnr`, `quality`, `gaussians` and `lossless` may be given; by default the quality is 70. */
export interface EncodeOptions {
  /** Bytes of the samples divided by bytes of the file. */
  ratio?: number
  /** Maximum size of the file, bytes. */
  bytes?: number
  /** Minimum PSNR, dB. */
  psnr?: number
  /**
   * SSIMULACRA2 score of the file, 0 to 100, met within half a point: 30 is low, 50 medium, 70 (the default) high and 90 very high quality.
   * Where the picture without loss takes no more bytes, it is stored without loss.
   */
  quality?: number
  /** Number of Gaussians. */
  gaussians?: number
  /** true: the file decodes to the samples of the picture. Colours under alpha 0 become black. */
  lossless?: boolean
  /** 1 to 9, by default 5; higher efforts take longer and give better pictures. */
  effort?: number
  /** The measure to favour: by default "iq" (perceptual quality), or "psnr" if a PSNR is requested. */
  tune?: "psnr" | "iq"
  /** Time limit, seconds. The result is the best state so far, so it depends on the speed of the machine. */
  time?: number
  seed?: number
  /** Whether the file has a detail layer if it gains by it. */
  detail?: "auto" | "off"
  /** 1 to 8 progressive levels. */
  levels?: number
  /** Code points of the colours by ITU-T H.273: primaries, transfer characteristics, 0, and 1 for full range; `[9, 16, 0, 1]` is BT.2020 with PQ. */
  cicp?: number[] | Uint8Array | ArrayBuffer
  /** ICC profile to store; without one, pixels are sRGB. */
  icc?: Uint8Array | ArrayBuffer
  /** EXIF block to store, starting with its TIFF header. */
  exif?: Uint8Array | ArrayBuffer
  /** EXIF orientation to store, 1 to 8. Pixels are not rotated. */
  orientation?: number
  /** `alloc`: maximum memory of the WebAssembly modules together, in bytes, by default 1 GiB, at most 4 GiB. */
  limits?: { alloc?: number }
  /** Whether to encode in a separate worker; by default true. In browsers, also a function that starts `encode-worker.js` as a module. */
  worker?: boolean | (() => Worker)
  /** The WebAssembly as a URL, bytes or a compiled module, if not that of the package. */
  module?: string | URL | ArrayBuffer | Uint8Array | WebAssembly.Module
  /** The WebAssembly that computes SSIMULACRA2, in the same way. It is loaded for encodes to a quality. */
  scoreModule?: EncodeOptions["module"]
  /** Stops the encode: at once in a worker, otherwise when `onProgress` aborts it. The promise is rejected with the signal's reason. */
  signal?: AbortSignal
  /** Receives the stage and the fraction of it that is done, 0 to 1. An exception stops the encode. */
  onProgress?: (stage: string, done: number) => void
}

export interface EncodeReport {
  /** Number of Gaussians. */
  gaussians: number
  /** PSNR in dB over the decoded samples; Infinity if all are equal. */
  psnr: number
  /** SSIMULACRA2 score, if a quality is the target, as by default. */
  quality?: number
  seconds: number
  stages: { name: string; seconds: number }[]
  /** Parts that the encoder omitted because the picture does not need them, and the bytes saved. */
  leftOut: { what: string; bytes: number }[]
}

/** Encodes pixels to an .ssplat file: the same bytes as the program's. Several calls can run at the same time, each in its own worker. */
export function encode(pixels: EncodePixels, options?: EncodeOptions): Promise<{ bytes: Uint8Array; report: EncodeReport }>

/**
 * Computes the SSIMULACRA2 score of `test` against `reference`, two pictures of the same size, channels and depth: at most 100, for
 * identical pictures; 90 very high, 70 high, 50 medium, 30 low quality. Pictures with a side below 64 pixels are mirrored.
 */
export function ssimulacra2(reference: EncodePixels, test: EncodePixels, options?: Pick<EncodeOptions, "limits" | "worker" | "scoreModule" | "signal">): Promise<number>

/** Fetches and compiles the WebAssembly before it is needed; that which computes SSIMULACRA2 too, unless `quality` is false. */
export function preload(options?: { quality?: boolean }): Promise<void>
