import type { ImportOptions, PluginOptions } from "./import-picture.js"

export type { ImportOptions, PluginOptions }

/** With `serviceWorker`, the script of the service worker is copied to `public/ssplat-service-worker.js`, which `ssplat/register` installs. */
export type NextOptions = PluginOptions & { serviceWorker?: boolean }

/** Adds imports such as `"./photo.jpg?ssplat"` to a configuration of Next.js, for Turbopack and webpack. */
export function withSsplat<Config extends object>(config?: Config, options?: NextOptions): Config
