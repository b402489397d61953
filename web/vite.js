// The plugin for Vite and Rollup: import photo from "./photo.jpg?ssplat"
import { readFile } from "node:fs/promises"
import { basename, join, resolve } from "node:path"
import { importPicture, imports, moduleText, settingsOf, split } from "./import-picture.js"

export default function ssplat(options) {
  const settings = settingsOf(options)
  // The configuration of Vite; undefined in Rollup.
  let config
  return {
    name: "ssplat",
    // Runs before Vite's own handling of pictures.
    enforce: "pre",

    configResolved(resolved) {
      config = resolved
      settings.cacheDir = resolve(config.root, settings.cacheDir ?? join(config.cacheDir, "ssplat"))
    },

    resolveId: {
      filter: { id: imports },
      async handler(id, importer) {
        const asked = split(id), found = asked && await this.resolve(asked.path, importer, { skipSelf: true })
        return found ? `${found.id}?${asked.query}` : null
      },
    },

    load: {
      filter: { id: imports },
      async handler(id) {
        const asked = split(id)
        if (!asked) return null
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
