// The imports "./photo.jpg?ssplat" in Next.js, by Turbopack or webpack: export default withSsplat({ …the configuration… })
import { copyFileSync, mkdirSync } from "node:fs"
import { fileURLToPath } from "node:url"
import { imports, settingsOf } from "./import-picture.js"

const pictures = "*.{jpg,jpeg,png,webp,avif,tif,tiff,gif,svg}"
const files = /[?&]ssplat=file(&|$)/
const loader = "ssplat/webpack"

function turbopackRules(rules, options) {
  const loaders = [{ loader, options }], former = rules[pictures] ?? []
  return {
    ...rules,
    [pictures]: [
      { condition: { query: imports }, loaders, as: "*.js" },
      { condition: { query: files }, loaders, as: "*.ssplat" },
      ...Array.isArray(former) ? former : [former],
    ],
    "*.ssplat": { type: "asset" },
  }
}

// Adds the loader to a configuration of Next.js, which may be a function. `options` are the plugin options; with `serviceWorker` the script of
// the service worker is copied to public/ssplat-service-worker.js, where ssplat/register expects it.
export function withSsplat(config = {}, { serviceWorker = false, ...options } = {}) {
  settingsOf(options)
  if (serviceWorker) {
    mkdirSync("public", { recursive: true })
    copyFileSync(fileURLToPath(new URL("./service-worker.js", import.meta.url)), "public/ssplat-service-worker.js")
  }
  if (typeof config == "function") return async (...words) => withSsplat(await config(...words), options)
  return {
    ...config,
    turbopack: { ...config.turbopack, rules: turbopackRules(config.turbopack?.rules ?? {}, options) },
    webpack(given, context) {
      const { module, ...rest } = config.webpack?.(given, context) ?? given
      // Excludes these imports from Next.js's own image loader.
      const rules = module.rules.map(rule => rule?.loader == "next-image-loader" ? { ...rule, resourceQuery: { not: [...rule.resourceQuery?.not ?? [], imports] } } : rule)
      // The server compilers must emit into the client's folder, given here relative to their own output folder.
      const outputPath = !context.isServer ? "" : context.dev || context.nextRuntime == "edge" ? "../" : "../../"
      const asset = { test: /\.ssplat$/, type: "asset/resource", generator: { filename: "static/media/[name].[hash:8][ext]", outputPath } }
      return { ...rest, module: { ...module, rules: [...rules, asset, { resourceQuery: imports, type: "javascript/auto", loader, options: { ...options, assets: "rules" } }] } }
    },
  }
}
