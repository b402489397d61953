import type { EncodeOptions, EncodeReport } from "./encode.js"

export type { EncodeOptions, EncodeReport }

/** An error of the encode. */
export class SsplatError extends Error {
  /**
   * format: the picture is broken or of a format that sharp does not read; dependency: the package sharp is not installed or does not
   * load; parameter: a wrong argument or option; size: the file that was asked for is too small for the picture; limit: the encode needs more
   * memory than `limits.alloc`, or sharp refuses so many pixels; network: the WebAssembly could not be read; internal: the encoder failed.
   */
  readonly kind: "format" | "dependency" | "parameter" | "size" | "limit" | "network" | "internal"
}

/** The options of `encode`, except those for metadata, which comes from the picture. `limits.alloc` is 4 GiB by default. */
export interface EncodeFileOptions extends Omit<EncodeOptions, "icc" | "exif" | "orientation"> {
  /** Reduces the picture so that its longer side has at most this many pixels. */
  maxSide?: number
  /** Most bytes of the placeholder, by default 300, at most 16384; 0 makes none. */
  placeholder?: number
}

export interface EncodedFile {
  /** The .ssplat file. */
  bytes: Uint8Array
  /** Pixels of the picture, upright. */
  width: number
  height: number
  /** A small .ssplat file as a data URI, for the attribute `placeholder` of `<ssplat-img>`; empty if none was asked for. */
  placeholder: string
  report: EncodeReport
}

/**
 * Encodes a picture file, given by its path, its URL or its bytes, to an .ssplat file. The package `sharp` reads the picture: JPEG, PNG,
 * WebP, AVIF, TIFF, GIF, SVG. Its pixels are turned upright by the EXIF orientation. Samples of 16 bits stay so, and so does an ICC
 * profile, unless it is sRGB. CMYK becomes sRGB. Other metadata is left out. Rejects with a SsplatError, or with the error of
 * Node.js if the file cannot be read.
 */
export function encodeFile(input: string | URL | Uint8Array, options?: EncodeFileOptions): Promise<EncodedFile>
