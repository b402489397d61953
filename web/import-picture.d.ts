import type { EncodeFileOptions } from "./node.js"

/** Options that the query of an import can have. */
export type ImportOptions = Pick<EncodeFileOptions, "ratio" | "bytes" | "psnr" | "quality" | "gaussians" | "effort" | "tune" | "seed" | "detail" | "levels" | "maxSide" | "placeholder">

/** Options of the plugins: the defaults for all imports. A target in a query replaces the one given here. */
export interface PluginOptions extends ImportOptions {
  /**
   * Folder of the encoded files, relative to the project. By default `ssplat` in Vite's `cacheDir`, otherwise
   * `node_modules/.cache/ssplat`.
   */
  cacheDir?: string
}
