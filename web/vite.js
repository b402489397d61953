// The plugin for Vite and Rollup: import photo from "./photo.jpg?ssplat"
import { readFile, realpath } from "node:fs/promises"
import { createRequire } from "node:module"
import { basename, join, resolve } from "node:path"
import { fileURLToPath, pathToFileURL } from "node:url"
import { SsplatError } from "./error.js"
import { importPicture, imports, moduleText, settingsOf, split } from "./import-picture.js"

// Returns the Vite of the project, otherwise the one beside this package.
async function viteOf(root) {
  try {
    return await import(pathToFileURL(createRequire(join(root, "package.json")).resolve("vite")).href)
  } catch {
    return import("vite")
  }
}

// Tells whether Vite's development server may serve the file at `path`, by `server.fs`. Links are followed, as Vite follows them.
async function isServed(path, server) {
  const { isFileLoadingAllowed, isFileServingAllowed, normalizePath } = await viteOf(server.config.root)
  const isAllowed = path => isFileLoadingAllowed ? isFileLoadingAllowed(server.config, path) : isFileServingAllowed(join("/@fs/", path), server)
  const plain = resolve(path)
  if (!isAllowed(normalizePath(plain))) return false
  return server.config.resolve.preserveSymlinks || isAllowed(normalizePath(await realpath(plain).catch(() => plain)))
}

const ofPackage = name => fileURLToPath(new URL(name, import.meta.url))
// The id of a module of this package.
const idOf = name => ofPackage(name).replaceAll("\\", "/")

// Files at the base of the site for pages that import ssplat/register: the service worker, which serves only pages below its own folder, and
// the WebAssembly for it where register.js has no URL of that.
const workerFiles = {
  "ssplat-service-worker.js": { path: ofPackage("service-worker.js"), type: "text/javascript" },
  "ssplat-simd.wasm": { path: ofPackage("ssplat-simd.wasm"), type: "application/wasm" },
}

export default function ssplat(options) {
  const settings = settingsOf(options)
  // The configuration of Vite, undefined in Rollup; and its development server, undefined during a build.
  let config, server
  // The ids that modules of the project import. The server encodes nothing else, because anyone who reaches it, such as any page in the
  // same browser, can request any picture with any options.
  const imported = new Set()
  // Code that runs on the server may import any file, as in Vite itself.
  const isForBrowser = ({ environment }, options) => server && (environment ? environment.config.consumer == "client" : !options?.ssr)
  return {
    name: "ssplat",
    // Runs before Vite's own handling of pictures.
    enforce: "pre",

    configResolved(resolved) {
      config = resolved
      settings.cacheDir = resolve(config.root, settings.cacheDir ?? join(config.cacheDir, "ssplat"))
    },

    configureServer(started) {
      server = started
      for (const [name, { path, type }] of Object.entries(workerFiles))
        server.middlewares.use(config.base + name, async (request, response) => response.setHeader("content-type", type).end(await readFile(path)))
    },

    // A page whose script imports the element fetches the decoder together with the script.
    transformIndexHtml: {
      order: "post",
      handler(html, { bundle, chunk, path }) {
        if (!bundle || !chunk || config.experimental?.renderBuiltUrl) return
        const reached = new Set([chunk.fileName])
        for (const name of reached) for (const next of bundle[name]?.imports ?? []) reached.add(next)
        const ids = [...reached].flatMap(name => Object.keys(bundle[name]?.modules ?? {})).map(id => id.split("?")[0])
        const wasm = Object.values(bundle).find(({ type, names }) => type == "asset" && names?.includes("ssplat-simd.wasm"))
        if (!wasm || !ids.includes(idOf("ssplat-img.js"))) return
        // A relative base is relative to the page.
        const base = /^(\.\/)?$/.test(config.base) ? `./${"../".repeat(path.split("/").length - 2)}` : config.base
        return [{ tag: "link", attrs: { rel: "preload", href: base + wasm.fileName, as: "fetch", crossorigin: "" }, injectTo: "head-prepend" }]
      },
    },

    async generateBundle() {
      const ids = [...this.getModuleIds()].map(id => id.split("?")[0])
      if (!ids.includes(idOf("register.js"))) return
      for (const [fileName, { path }] of Object.entries(workerFiles))
        if (!config || path.endsWith(".js")) this.emitFile({ type: "asset", fileName, source: await readFile(path) })
    },

    resolveId: {
      filter: { id: imports },
      async handler(id, importer, options) {
        const asked = split(id), found = asked && await this.resolve(asked.path, importer, { skipSelf: true })
        const resolved = found ? `${found.id}?${asked.query}` : null
        if (!asked || !isForBrowser(this, options)) return resolved
        // The importer of a request, as Vite gives it; an import in that page has a query.
        const isRequest = !importer || resolve(importer) == resolve(config.root, "index.html")
        if (!isRequest && resolved) imported.add(resolved)
        // The same answer whether the file exists or not.
        return isRequest && !imported.has(resolved) ? id : resolved
      },
    },

    load: {
      filter: { id: imports },
      async handler(id, options) {
        const asked = split(id)
        if (!asked) return null
        if (isForBrowser(this, options)) {
          if (!imported.has(id)) throw new SsplatError("parameter", `${id}: not imported by a module that this server has sent`)
          if (!await isServed(asked.path, server)) throw new SsplatError("parameter", `${asked.path}: Vite may not serve this file, see server.fs`)
        }
        this.addWatchFile(asked.path)
        settings.cacheDir ??= resolve("node_modules/.cache/ssplat")
        const log = words => config ? config.logger.info(`ssplat: ${words}`) : this.info(words)
        const picture = await importPicture(asked.path, asked.query, settings, log)
        // Vite serves or emits the file like any other asset.
        if (config) return moduleText(`import src from ${JSON.stringify(`${picture.file.replaceAll("\\", "/")}?url&no-inline`)}`, "src", picture)
        const asset = this.emitFile({ type: "asset", name: basename(picture.file), source: await readFile(picture.file) })
        return moduleText("", `import.meta.ROLLUP_FILE_URL_${asset}`, picture)
      },
    },
  }
}
