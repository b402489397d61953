import type { ImportOptions, PluginOptions } from "./import-picture.js"

export type { ImportOptions, PluginOptions }

/** Adds imports such as `"./photo.jpg?ssplat"` to a configuration of Next.js, for Turbopack and webpack. */
export function withSsplat<Config extends object>(config?: Config, options?: PluginOptions): Config
