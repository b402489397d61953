// The loader for webpack, and for Turbopack in Next.js: { resourceQuery: /[?&]ssplat/, loader: "ssplat/webpack" }
import { readFile } from "node:fs/promises"
import { basename, dirname, join, relative, resolve } from "node:path"
import { SsplatError } from "./error.js"
import { importPicture, moduleText, settingsOf } from "./import-picture.js"

// The picture is read here; nothing before this loader makes text of it.
export const raw = true

// The name of a file as an import relative to the picture's folder.
function specifier(file, picture) {
  const path = relative(dirname(picture), file).replaceAll("\\", "/")
  return path.startsWith(".") ? path : `./${path}`
}

// By default webpack emits a file of the cache as an asset, whatever its rules say. Turbopack sees no files that appear while it runs;
// there this loader is asked once more, for the bytes.
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
  // webpack keeps errors in its cache, and knows only those of the language.
  load(this).then(result => done(null, result), error => done(error instanceof SsplatError ? new Error(error.message) : error))
}
