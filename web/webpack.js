// The loader for webpack, and for Turbopack in Next.js: { resourceQuery: /[?&]ssplat/, loader: "ssplat/webpack" }
import { dirname, join, relative, resolve } from "node:path"
import { importPicture, moduleText, settingsOf } from "./import-picture.js"

// The picture is read here; nothing before this loader makes text of it.
export const raw = true

// The name of a file as an import relative to the picture's folder.
function specifier(file, picture) {
  const path = relative(dirname(picture), file).replaceAll("\\", "/")
  return path.startsWith(".") ? path : `./${path}`
}

async function load(context) {
  const settings = settingsOf(context.getOptions()), root = context.rootContext ?? process.cwd()
  settings.cacheDir = resolve(root, settings.cacheDir ?? join("node_modules", ".cache", "ssplat"))
  const picture = await importPicture(context.resourcePath, context.resourceQuery.slice(1), settings, words => context.getLogger?.("ssplat").info(words))
  const path = specifier(picture.file, context.resourcePath)
  // webpack emits the file as an asset whatever its rules say; Turbopack has a rule for it.
  const request = context.webpack ? `${path}.webpack[asset/resource]!=!${path}` : path
  return moduleText(`import src from ${JSON.stringify(request)}`, "src", picture)
}

export default function () {
  const done = this.async()
  load(this).then(text => done(null, text), done)
}
