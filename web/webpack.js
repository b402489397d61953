// The loader for webpack, and for Turbopack in Next.js: { resourceQuery: /[?&]ssplat/, loader: "ssplat/webpack" }; and a plugin that emits the
// service worker.
import { readFile } from "node:fs/promises"
import { basename, dirname, join, relative, resolve } from "node:path"
import { SsplatError } from "./error.js"
import { importPicture, moduleText, settingsOf } from "./import-picture.js"

// Keeps webpack from converting the picture to text before this loader runs.
export const raw = true

// Returns the import specifier of `file` relative to the folder of `picture`.
function specifier(file, picture) {
  const path = relative(dirname(picture), file).replaceAll("\\", "/")
  return path.startsWith(".") ? path : `./${path}`
}

// Returns the specifier from which the module imports the URL. In webpack it is the cached file, by default with an inline asset type that
// needs no rule. Turbopack does not see files that appear during a build, so there the loader is called again and returns the bytes.
function sourceOf(file, assets, { webpack, resourcePath, resourceQuery }) {
  if (!webpack) return `./${basename(resourcePath)}${resourceQuery.replace(/([?&])ssplat(?=&|$)/, "$1ssplat=file")}`
  const path = specifier(file, resourcePath)
  return assets == "rules" ? path : `${path}.webpack[asset/resource]!=!${path}`
}

async function load(context) {
  const { assets = "inline", ...options } = context.getOptions()
  if (!["inline", "rules"].includes(assets)) throw new SsplatError("parameter", `assets is ${assets}, neither inline nor rules`)
  const settings = settingsOf(options), root = context.rootContext ?? process.cwd()
  settings.cacheDir = resolve(root, settings.cacheDir ?? join("node_modules", ".cache", "ssplat"))
  const query = context.resourceQuery.slice(1)
  const picture = await importPicture(context.resourcePath, query, settings, words => context.getLogger?.("ssplat").info(words))
  if (new URLSearchParams(query).get("ssplat") == "file") return readFile(picture.file)
  return moduleText(`import src from ${JSON.stringify(sourceOf(picture.file, assets, context))}`, "src", picture)
}

export default function () {
  const done = this.async()
  // webpack's cache cannot serialize custom error classes.
  load(this).then(result => done(null, result), error => done(error instanceof SsplatError ? new Error(error.message) : error))
}

// Emits the service worker as ssplat-service-worker.js, which ssplat/register installs.
export class ServiceWorkerPlugin {
  apply(compiler) {
    const { Compilation, sources } = compiler.webpack, stage = Compilation.PROCESS_ASSETS_STAGE_ADDITIONAL
    compiler.hooks.thisCompilation.tap("ssplat", compilation => compilation.hooks.processAssets.tapPromise({ name: "ssplat", stage }, async () => {
      compilation.emitAsset("ssplat-service-worker.js", new sources.RawSource(await readFile(new URL("./service-worker.js", import.meta.url))))
    }))
  }
}
