import type { EncodeOptions, EncodeReport } from "./encode.js"

export type { EncodeOptions, EncodeReport }

/** An error of the encode. */
export class SsplatError extends Error {
  /**
   * format: the picture is broken or of a format that sharp does not support; dependency: the package sharp is not installed or cannot be
   * loaded; parameter: a wrong argument or option; size: the requested file is too small for the picture; limit: the encode needs more
   * memory than `limits.alloc`, or sharp rejects the number of pixels; network: the WebAssembly could not be read; internal: the encoder failed.
   */
  readonly kind: "format" | "dependency" | "parameter" | "size" | "limit" | "network" | "internal"
}

/** The options of `encode`, except those for metadata, which comes from the picture. `limits.alloc` is 4 GiB by default. */
export interface EncodeFileOptions extends Omit<EncodeOptions, "icc" | "exif" | "orientation"> {
  /** Downscales the picture so that its longer side has at most this many pixels. */
  maxSide?: number
  /** Maximum size of the placeholder in bytes, by default 300, at most 16384; 0 disables it. */
  placeholder?: number
}

export interface EncodedFile {
  /** The .ssplat file. */
  bytes: Uint8Array
  /** Size of the picture after its orientation has been applied, pixels. */
  width: number
  height: number
  /** A small .ssplat file as a data URI, for the attribute `placeholder` of `<ssplat-img>`; empty if none was requested. */
  placeholder: string
  report: EncodeReport
}

/**
 * Encodes a picture file, given by its path, its URL or its bytes, to an .ssplat file. The package `sharp` reads the picture: JPEG, PNG,
 * WebP, AVIF, TIFF, GIF, SVG. The pixels are rotated according to the EXIF orientation. Samples of 16 bits are kept, and so is an
 * ICC profile unless it is sRGB. CMYK is converted to sRGB. Other metadata is omitted. Rejects with a SsplatError, or with the error of
 * Node.js if the file cannot be read.
 */
export function encodeFile(input: string | URL | Uint8Array, options?: EncodeFileOptions): Promise<EncodedFile>
