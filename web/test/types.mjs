// The types of the packed package in TypeScript with React, Preact, Solid, Vue and Svelte: node web/test/types.mjs
// Then every export is imported in Node.js, with and without `.js`.
import assert from "node:assert/strict"
import { cpSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs"
import { tmpdir } from "node:os"
import { join } from "node:path"
import { install, npm, pack } from "./packed.js"

const home = mkdtempSync(join(tmpdir(), "ssplat-types-"))
try {
  cpSync(new URL("types/", import.meta.url), home, { recursive: true })
  const dependencies = { "@types/node": "^20.0.0", "@types/react": "^19.0.0", preact: "^10.27.0", "solid-js": "^1.9.0", svelte: "^5.0.0", typescript: "^5.9.0", vue: "^3.5.0" }
  writeFileSync(join(home, "package.json"), JSON.stringify({ private: true, type: "module", scripts: { types: "tsc", modules: "node modules.mjs" }, dependencies }))
  const options = { target: "es2022", lib: ["dom", "dom.iterable", "esnext"], module: "esnext", moduleResolution: "bundler", jsx: "preserve", types: ["node", "ssplat/client"], strict: true, skipLibCheck: true, noEmit: true }
  writeFileSync(join(home, "tsconfig.json"), JSON.stringify({ compilerOptions: options, include: ["*.ts", "*.tsx"] }))
  const { filename } = await pack(home)
  await install(home, join(home, filename))
  await npm(home, "run", "types")

  const { exports } = JSON.parse(readFileSync(join(home, "node_modules/ssplat/package.json"))), modules = Object.keys(exports).filter(name => exports[name].default)
  for (const name of modules) if (name != ".") assert(exports[name.endsWith(".js") ? name.slice(0, -3) : `${name}.js`] || name == "./ssplat.js", `${name} has only one name`)
  writeFileSync(join(home, "modules.mjs"), `const names = ${JSON.stringify(modules)}
for (const name of names) {
  const module = await import(name.replace(".", "ssplat")), { default: first, ...others } = module
  if (!first && !Object.keys(others).length) throw new Error(name + " exports nothing")
}
console.log(names.length + " exports")`)
  console.log(/\d+ exports/.exec(await npm(home, "run", "modules"))[0], "in Node.js, and their types in TypeScript with React, Preact, Solid, Vue and Svelte")
} finally {
  rmSync(home, { recursive: true, force: true, maxRetries: 20, retryDelay: 250 })
}
