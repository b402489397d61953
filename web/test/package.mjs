// The package of web/dist in Node.js and in headless Chromium: node web/test/package.mjs [PROGRAM]
// PROGRAM is the native `ssplat`, whose samples the package must give; without it, target/release/ssplat.
// With SSPLAT_REQUIRE_BROWSER=1 a missing Chromium is a failure, otherwise the browser is named as skipped.
import { execFileSync } from "node:child_process"
import { mkdtempSync, readFileSync, readdirSync, rmSync, statSync, writeFileSync } from "node:fs"
import { tmpdir } from "node:os"
import { join } from "node:path"
import { brotliCompressSync, constants } from "node:zlib"
import { inChromium } from "./chromium.mjs"
import { Decoder } from "../dist/ssplat.js"
import { run, crc32, rgbaOfPam } from "./files.js"

const root = new URL("../../", import.meta.url), vectors = new URL("spec/vectors/", root)
const program = process.argv[2] ?? new URL("target/release/ssplat", root).pathname
const load = path => new Uint8Array(readFileSync(new URL(path, vectors)))

// What the native decoder draws: RGBA, or its checksum for a browser.
const home = mkdtempSync(join(tmpdir(), "ssplat-web-"))
const cases = []
for (const folder of ["valid", "reduced", "invalid", "limits"])
  for (const name of readdirSync(new URL(folder, vectors))) {
    const path = `${folder}/${name}/file.ssplat`
    const size = /^size: (\d+) (\d+)$/m.exec(readFileSync(new URL(`${folder}/${name}/case.txt`, vectors), "utf8"))
    const one = { path, width: size ? +size[1] : undefined, height: size ? +size[2] : undefined }
    if (folder == "valid" || folder == "reduced") {
      const out = join(home, "native.pam")
      execFileSync(program, ["decode", new URL(path, vectors).pathname, out, ...(size ? ["--width", size[1], "--height", size[2]] : [])])
      Object.assign(one, rgbaOfPam(readFileSync(out)))
    }
    cases.push(one)
  }
rmSync(home, { recursive: true })

// Most bytes as brotli of the WebAssembly and the modules that it needs.
// The scalar one, for browsers from before 2023, may take more: its loops over pixels are longer.
const budgets = { simd: 95_000, scalar: 102_000 }

let failed = false
function tell(where, { problems, words }) {
  for (const problem of problems) console.log(`FAILED in ${where}: ${problem}`)
  console.log(`${where}: ${words}, ${problems.length} failed`)
  failed ||= problems.length > 0
}

// The last is what the program holds.
for (const path of ["dist/ssplat-simd.wasm", "dist/ssplat-scalar.wasm", "ssplat-simd.wasm"]) {
  const module = readFileSync(new URL(`../${path}`, import.meta.url))
  tell(`Node.js, ${path}`, await run(cases, load, new Decoder({ module })))
}
const dist = new URL("../dist/", import.meta.url)
const brotli = files => brotliCompressSync(Buffer.concat(files.map(f => readFileSync(new URL(f, dist)))), { params: { [constants.BROTLI_PARAM_LGWIN]: 24 } }).length
const modules = ["error.js", "icc.js", "machine.js", "source.js", "ssplat.js"]
for (const kind of ["simd", "scalar"]) {
  const wasm = `ssplat-${kind}.wasm`, size = brotli([wasm]) + brotli(modules)
  console.log(`${wasm}: ${statSync(new URL(wasm, dist)).size} bytes, ${brotli([wasm])} as brotli, ${size} with the modules`)
  if (size > budgets[kind]) tell("size", { problems: [`${size} bytes as brotli are more than ${budgets[kind]}`], words: wasm })
}

const photo = new URL("tests/images/kodim05.png", root).pathname, shown = new URL("valid/coded-rgb/file.ssplat", vectors).pathname
execFileSync(program, ["view", shown, "--html", new URL("packed.html", dist).pathname])
execFileSync(program, ["view", shown, "--original", photo, "--html", new URL("packed-original.html", dist).pathname])
// The element as a page has it, showing a file of this repository.
const element = execFileSync(program, ["placeholder", photo, "--format", "html", "--effort", "1", "--src", "/web/viewer/samples/motocross.ssplat"])
writeFileSync(new URL("placeholder.html", dist), element)

// Browsers are told the checksums, not the samples.
const told = cases.map(({ rgba, ...one }) => ({ ...one, checksum: rgba && crc32(rgba) }))
const pages = readdirSync(new URL("pages/", import.meta.url)).filter(f => f.endsWith(".js"))
for (const page of pages) {
  const answer = await inChromium(root, `/web/test/pages/${page}`, told, { webgpu: page == "webgpu.js" })
  if (answer) tell(`Chromium, ${page}`, answer)
  else if (process.env.SSPLAT_REQUIRE_BROWSER == "1") tell("Chromium", { problems: ["it is not installed"], words: page })
  else console.log(`Chromium, ${page}: skipped, it is not installed`)
}
process.exit(failed ? 1 : 0)
