// Runs checks.js in Node.js: node web/test/run.mjs
import { readFileSync, readdirSync } from "node:fs"
import { run } from "./checks.js"

const vectors = new URL("../../spec/vectors/", import.meta.url)
const names = Object.fromEntries(["valid", "invalid", "limits"].map(folder => [folder, readdirSync(new URL(folder, vectors))]))
const { problems, words } = await run(names, path => new Uint8Array(readFileSync(new URL(path, vectors))))
for (const problem of problems) console.log(`FAILED: ${problem}`)
console.log(`placeholder.js: ${words}, ${problems.length} failed`)
process.exit(problems.length ? 1 : 0)
