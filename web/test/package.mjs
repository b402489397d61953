// The package of web/dist in Node.js and in headless Chromium: node web/test/package.mjs [PROGRAM] PROGRAM is the native `ssplat`, by
// default target/release/ssplat; the package must return the same samples. With SSPLAT_REQUIRE_BROWSER=1 a missing Chromium is a failure,
// otherwise the browser is named as skipped.
import { execFileSync } from "node:child_process"
import { existsSync, mkdtempSync, readFileSync, readdirSync, rmSync, statSync, writeFileSync } from "node:fs"
import { tmpdir } from "node:os"
import { join } from "node:path"
import { brotliCompressSync, constants } from "node:zlib"
import { inChromium } from "./chromium.mjs"
import { encode } from "../dist/encode.js"
import { Decoder } from "../dist/ssplat.js"
import { run, crc32, rgbaOfPam } from "./files.js"
import { generated } from "./generated.js"
import { test as testServiceWorker } from "./service-worker.mjs"

const root = new URL("../../", import.meta.url), vectors = new URL("spec/vectors/", root)
const program = process.argv[2] ?? new URL("target/release/ssplat", root).pathname
const load = path => new Uint8Array(readFileSync(new URL(path, vectors)))

// The result of the native decoder: RGBA, or its checksum for a browser.
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

// Maximum size of the WebAssembly and its modules, compressed with brotli. The scalar build, for browsers from before 2023, may be larger,
// because its loops over pixels are longer.
const budgets = { simd: 112_500, scalar: 118_000 }

let failed = false
function tell(where, { problems, words }) {
  for (const problem of problems) console.log(`FAILED in ${where}: ${problem}`)
  console.log(`${where}: ${words}, ${problems.length} failed`)
  failed ||= problems.length > 0
}

// The last one is embedded in the program.
for (const path of ["dist/ssplat-simd.wasm", "dist/ssplat-scalar.wasm", "ssplat-simd.wasm"]) {
  const module = readFileSync(new URL(`../${path}`, import.meta.url))
  tell(`Node.js, ${path}`, await run(cases, load, new Decoder({ module })))
}
// Files of other kinds are named.
const started = { "HTML or XML; is the path right?": "\n<!doctype html>", "a PNG picture": "\x89PNG\r\n\x1a\n", "a JPEG picture": "\xff\xd8\xff\xe0", "a valid ssplat file: bad magic [61, 62, 63, 64]": "abcdef", "the file is empty (0 bytes), not an ssplat file": "" }
for (const [words, start] of Object.entries(started)) {
  const said = await new Decoder({ module: readFileSync(new URL("../dist/ssplat-simd.wasm", import.meta.url)) }).header(Uint8Array.from(start, c => c.charCodeAt(0))).catch(error => error.message)
  if (!String(said).endsWith(words)) tell("Node.js", { problems: [`${JSON.stringify(start)}: ${said}`], words: "other files" })
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
// The element in a page, showing a file of this repository.
const element = execFileSync(program, ["placeholder", photo, "--format", "html", "--effort", "1", "--src", "/web/viewer/samples/motocross.ssplat"])
writeFileSync(new URL("placeholder.html", dist), element)

// Browsers receive the checksums, not the samples.
const told = cases.map(({ rgba, ...one }) => ({ ...one, checksum: rgba && crc32(rgba) }))
// Files encoded by Node.js, for comparison in the browsers.
const encoded = []
for (const [name, width, height, channels, depth, options] of [
  ["colours", 96, 64, 3, 8, { ratio: 40, effort: 2 }],
  ["alpha of 16 bits", 40, 56, 4, 16, { bytes: 700, effort: 1 }],
  ["grey", 72, 72, 1, 8, { psnr: 26, effort: 1 }],
  ["quality", 64, 64, 3, 8, { quality: 40, effort: 1 }],
]) {
  const { bytes } = await encode(generated(width, height, channels, depth), options)
  encoded.push({ name, picture: { width, height, channels, depth }, options, checksum: crc32(bytes) })
}

// axe-core, from npm, finds accessibility faults.
const lint = new URL("target/lint/", root), axe = new URL("node_modules/axe-core/axe.min.js", lint)
if (!existsSync(axe))
  try {
    execFileSync("npm", ["install", "--silent", "--no-save", "--prefix", lint.pathname, "axe-core@4.14.1"])
  } catch (error) {
    if (process.env.SSPLAT_REQUIRE_BROWSER == "1") tell("axe", { problems: [`npm cannot install it: ${error.message}`], words: "missing" })
  }
// The requests of a page since the last call.
const asked = []
function serve(url) {
  if (url == "/asked") return { body: JSON.stringify(asked.splice(0)), headers: { "content-type": "application/json" } }
  if (url == "/axe.js") return { body: readFileSync(axe) }
  asked.push(url)
}

const more = { encoded, axe: existsSync(axe) }
// With SSPLAT_PAGES=encode.js,maker.js only these.
const wanted = process.env.SSPLAT_PAGES?.split(",")
const pages = readdirSync(new URL("pages/", import.meta.url)).filter(f => f.endsWith(".js") && (!wanted || wanted.includes(f)))
for (const page of pages) {
  const answer = await inChromium(root, `/web/test/pages/${page}`, told, { webgpu: page == "webgpu.js", more, serve })
  if (answer) tell(`Chromium, ${page}`, answer)
  else if (process.env.SSPLAT_REQUIRE_BROWSER == "1") tell("Chromium", { problems: ["it is not installed"], words: page })
  else console.log(`Chromium, ${page}: skipped, it is not installed`)
}
if (!wanted || wanted.includes("service-worker.mjs")) {
  const answer = await testServiceWorker()
  if (answer) tell("Chromium, service-worker.mjs", answer)
  else if (process.env.SSPLAT_REQUIRE_BROWSER == "1") tell("Chromium", { problems: ["it is not installed"], words: "service-worker.mjs" })
  else console.log("Chromium, service-worker.mjs: skipped, it is not installed")
}
process.exit(failed ? 1 : 0)
