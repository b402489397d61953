import type { ImportOptions, PluginOptions } from "./import-picture.js"

export type { ImportOptions, PluginOptions }
/** The options of the loader. */
export interface LoaderOptions extends PluginOptions {
  /**
   * "inline", the default, makes assets of the .ssplat files; "rules" leaves that to a rule of the configuration, such as
   * `{ test: /\.ssplat$/, type: "asset/resource" }`.
   */
  assets?: "inline" | "rules"
}

/** Whether the loader receives bytes. */
export const raw: true
/** The loader for webpack and Turbopack, used as `"ssplat/webpack"`. */
export default function load(this: unknown): void

/** A plugin that emits the service worker as `ssplat-service-worker.js`, for pages that import `ssplat/register`. */
export class ServiceWorkerPlugin {
  apply(compiler: object): void
}
