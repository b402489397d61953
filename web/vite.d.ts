import type { ImportOptions, PluginOptions } from "./import-picture.js"

export type { ImportOptions, PluginOptions }

/** A plugin for Vite and Rollup. */
export interface SsplatPlugin {
  name: "ssplat"
  enforce: "pre"
}

/** The plugin for Vite and Rollup: `import photo from "./photo.jpg?ssplat"`. */
export default function ssplat(options?: PluginOptions): SsplatPlugin
