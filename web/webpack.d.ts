import type { ImportOptions, PluginOptions } from "./import-picture.js"

export type { ImportOptions, PluginOptions }
/** The options of the loader. */
export type LoaderOptions = PluginOptions

/** Whether the loader takes bytes. */
export const raw: true
/** The loader for webpack and Turbopack, to be named as `"ssplat/webpack"`. */
export default function load(this: unknown): void
