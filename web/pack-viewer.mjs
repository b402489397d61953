#!/usr/bin/env node
// Writes the built viewer with a file in it as one page that needs nothing else: node web/pack-viewer.mjs photo.ssplat photo.html
import { readFileSync, writeFileSync } from "node:fs"

const [, , file, out] = process.argv
if (!out) {
  console.error("usage: node web/pack-viewer.mjs FILE.ssplat PAGE.html")
  process.exit(2)
}
const dist = new URL("dist/", import.meta.url), text = name => readFileSync(new URL(name, dist), "utf8")
const base64 = bytes => Buffer.from(bytes).toString("base64")

// Modules find each other by name in an import map, as a page of its own has no place beside it.
const modules = ["error.js", "icc.js", "machine.js", "ssplat.js", "viewer/viewer.js"]
const named = source => source.replace(/from "\.{1,2}\/(\w+\.js)"/g, 'from "ssplat/$1"')
const imports = Object.fromEntries(modules.map(m => [`ssplat/${m}`, `data:text/javascript;base64,${base64(named(text(m)))}`]))
const held = (id, bytes) => `<script type="application/octet-stream" id="${id}" data-name="${file.split("/").pop().replace(/[^\w.-]/g, "_")}">${base64(bytes)}</script>`
const page = text("viewer/index.html").replace('<script type="module" src="viewer.js"></script>', () => [
  held("held-module", readFileSync(new URL("ssplat-scalar.wasm", dist))),
  held("held-file", readFileSync(file)),
  `<script type="importmap">${JSON.stringify({ imports })}</script>`,
  '<script type="module">import "ssplat/viewer/viewer.js"</script>',
].join("\n"))
if (!page.includes("held-file")) throw new Error("viewer/index.html has no place for the file")
writeFileSync(out, page)
