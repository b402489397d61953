import type { ImportOptions, PluginOptions } from "./import-picture.js"

export type { ImportOptions, PluginOptions }
/** The options of the loader. */
export interface LoaderOptions extends PluginOptions {
  /**
   * "inline", the default, makes the .ssplat files assets by itself; "rules" leaves that to a rule of the configuration, such as
   * `{ test: /\.ssplat$/, type: "asset/resource" }`.
   */
  assets?: "inline" | "rules"
}

/** Whether the loader takes bytes. */
export const raw: true
/** The loader for webpack and Turbopack, to be named as `"ssplat/webpack"`. */
export default function load(this: unknown): void
