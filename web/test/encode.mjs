// The encoder of web/dist in Node.js: node web/test/encode.mjs [PROGRAM] PROGRAM is the native `ssplat`, by default target/release/ssplat;
// the files must be the same byte for byte.
import assert from "node:assert/strict"
import { execFileSync } from "node:child_process"
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs"
import { tmpdir } from "node:os"
import { join } from "node:path"
import { brotliCompressSync, constants } from "node:zlib"
import { SsplatError, encode, ssimulacra2 } from "../dist/encode.js"
import { decode, header } from "../dist/ssplat.js"
import { generated } from "./generated.js"
import { pixelsOfPng } from "./png.mjs"

const root = new URL("../../", import.meta.url), dist = new URL("../dist/", import.meta.url)
const program = process.argv[2] ?? new URL("target/release/ssplat", root).pathname
const home = mkdtempSync(join(tmpdir(), "ssplat-encode-"))
process.on("exit", () => rmSync(home, { recursive: true }))
// Maximum size of the encoder's WebAssembly, compressed with brotli. The scalar build, for browsers from before 2023, may be
// larger, because its loops over pixels are longer. SSIMULACRA2 is loaded only if it is needed.
const budgets = { simd: 368_000, scalar: 400_000 }, scoreBudget = 55_000

// The same picture for the program.
function write(path, { width, height, channels, data }) {
  const kinds = [, "GRAYSCALE", "GRAYSCALE_ALPHA", "RGB", "RGB_ALPHA"], isDeep = data instanceof Uint16Array
  const body = Buffer.from(data.buffer.slice(0))
  writeFileSync(path, Buffer.concat([
    Buffer.from(`P7\nWIDTH ${width}\nHEIGHT ${height}\nDEPTH ${channels}\nMAXVAL ${isDeep ? 65535 : 255}\nTUPLTYPE ${kinds[channels]}\nENDHDR\n`),
    isDeep ? body.swap16() : body,
  ]))
}

// Without --check-quick, web/build makes both.
const kinds = ["simd", "scalar"].filter(kind => existsSync(new URL(`ssplat-encode-${kind}.wasm`, dist)))
assert(kinds.includes("simd"))

// What a browser with or without vector instructions loads.
const modulesOf = kind => ({ module: new URL(`ssplat-encode-${kind}.wasm`, dist), scoreModule: new URL(`ssplat-score-${kind}.wasm`, dist) })

let checks = 0
// `isFitted`: the file has Gaussians, unlike one colour and files of an exact layer alone.
async function same(name, pixels, options, args, isFitted = pixels.width > 1) {
  const path = join(home, "picture.pam"), out = join(home, "native.ssplat")
  write(path, pixels)
  execFileSync(program, ["encode", "--quiet", path, out, ...args])
  const native = readFileSync(out)
  for (const kind of kinds) {
    const { bytes, report } = await encode(pixels, { ...options, ...modulesOf(kind) })
    assert(Buffer.compare(native, bytes) == 0, `${name}, ${kind}: ${bytes.length} bytes differ from the program's ${native.length}`)
    assert(report.psnr > 0 && report.seconds >= 0, name)
    if (isFitted) assert(report.gaussians > 0 && report.stages.length > 0, name)
    checks++
  }
}

for (const channels of [1, 2, 3, 4])
  for (const depth of [8, 16])
    await same(`${channels} channels of ${depth} bits`, generated(72, 56, channels, depth), { bytes: 400, effort: 2 }, ["--bytes", "400", "--effort", "2"])
const small = generated(64, 48, 3, 8)
await same("one pixel", generated(1, 1, 3, 8), {}, [])
await same("ratio", small, { ratio: 30, effort: 1 }, ["--ratio", "30", "--effort", "1"])
await same("psnr", small, { psnr: 25, effort: 1 }, ["--psnr", "25", "--effort", "1"])
await same("quality", small, { quality: 40, effort: 1 }, ["--quality", "40", "--effort", "1"])
await same("quality with alpha and 16 bits", generated(72, 56, 4, 16), { quality: 60, effort: 1 }, ["--quality", "60", "--effort", "1"])
await same("no loss", small, { lossless: true }, ["--lossless"], false)
await same("no loss, 16 bits and alpha", generated(40, 30, 4, 16), { lossless: true }, ["--lossless"], false)
await same("lossless: false", small, { lossless: false, bytes: 300, effort: 1 }, ["--bytes", "300", "--effort", "1"])
// Letters in many shades on white, which are stored without loss or with near colours.
const page = { width: 160, height: 120, channels: 3, data: new Uint8Array(160 * 120 * 3) }
for (let at = 0; at < 160 * 120; at++) {
  const x = at % 160, y = Math.floor(at / 160), glyph = (Math.floor(x / 9) * 31 + Math.floor(y / 16) * 17) % 61
  const isInk = x % 9 < 5 && y % 16 < 8 && (x % 9 * 5 + y % 16 * 3 + glyph) % 4 < 2, shade = (glyph * 37 + x * 13 + y * 7) % 120
  page.data.set(isInk ? [shade, shade, 20 + (shade >> 1)] : [255, 255, 255], 3 * at)
}
for (const [options, args] of [[{ ratio: 10 }, ["--ratio", "10"]], [{ ratio: 40 }, ["--ratio", "40"]], [{ psnr: 40 }, ["--psnr", "40"]], [{ quality: 80 }, ["--quality", "80"]]])
  await same(`page, ${JSON.stringify(options)}`, page, { effort: 1, ...options }, [...args, "--effort", "1"], false)
await same("tune", small, { tune: "psnr", effort: 1 }, ["--tune", "psnr", "--effort", "1"])
for (const name of ["kodim05", "kodim15"]) {
  const pixels = pixelsOfPng(readFileSync(new URL(`tests/images/${name}.png`, root)))
  for (const ratio of [50, 200])
    await same(`${name} at ${ratio}`, pixels, { ratio, effort: 1 }, ["--ratio", `${ratio}`, "--effort", "1"])
}

// The file contains the requested parts.
const icc = Uint8Array.from({ length: 200 }, (_, i) => i)
const turned = await header((await encode(small, { bytes: 900, effort: 1, orientation: 6, icc })).bytes)
assert.deepEqual([turned.orientation, turned.width, Buffer.compare(turned.icc, icc)], [6, 64, 0])
const clamped = { width: 64, height: 48, data: new Uint8ClampedArray(64 * 48 * 4).fill(200) }
assert((await encode(clamped, { bytes: 300 })).bytes.length <= 300)

// Errors are typed, and name what is wrong.
const fails = (kind, words, pixels, options) => assert.rejects(encode(pixels, options), error => {
  assert(error instanceof SsplatError && error.kind == kind && words.test(error.message), `${error.kind}: ${error.message}`)
  return checks++ >= 0
})
for (const worker of [true, false]) {
  // The encode itself fits, but not with a score beside it.
  const limits = { alloc: 7 << 20 }
  assert((await encode(small, { bytes: 400, effort: 1, limits, worker })).bytes.length <= 400)
  await fails("limit", /alloc/, small, { quality: 40, effort: 1, limits, worker })
  await fails("size", /cannot hold the picture/, small, { bytes: 5, worker })
  await fails("limit", /alloc/, generated(800, 800, 4, 8), { effort: 1, limits: { alloc: 8 << 20 }, worker })
}
await fails("parameter", /effort is 10/, small, { effort: 10 })
await fails("parameter", /effort is 2.5/, small, { effort: 2.5 })
await fails("parameter", /lossless is yes/, small, { lossless: "yes" })
await fails("parameter", /bytes and lossless/, small, { bytes: 9, lossless: true })
await fails("parameter", /ratio and bytes/, small, { ratio: 2, bytes: 9 })
await fails("parameter", /no option is called quallity/, small, { quallity: 70 })
await fails("parameter", /none of psnr, iq/, small, { tune: "best" })
await fails("parameter", /orientation is 9/, small, { orientation: 9 })
await fails("parameter", /width is 0/, { ...small, width: 0 })
await fails("parameter", /samples/, { ...small, height: 47 })
await fails("parameter", /neither/, { ...small, data: [...small.data] })
await fails("parameter", /pixels/, null)
await fails("network", /missing\.wasm/, small, { module: new URL("missing.wasm", dist) })
await fails("network", /missing\.wasm/, small, { quality: 40, scoreModule: new URL("missing.wasm", dist) })
// Without a quality the score is not loaded.
assert((await encode(small, { bytes: 300, effort: 1, scoreModule: new URL("missing.wasm", dist) })).bytes.length <= 300)
await assert.rejects(encode(small, { onProgress() { throw new RangeError("mine") } }), RangeError)
await assert.rejects(encode(small, { worker: false, onProgress() { throw new RangeError("mine") } }), RangeError)

// The SSIMULACRA2 score equals that of the program for the decoded picture.
{
  const path = new URL("tests/images/kodim15.png", root).pathname, out = join(home, "native.ssplat"), pixels = pixelsOfPng(readFileSync(path))
  execFileSync(program, ["encode", "--quiet", "--force", path, out, "--effort", "1"])
  const { ssimulacra2: native } = JSON.parse(execFileSync(program, ["compare", path, out, "--json"]))
  const { width, height, data: rgba } = await decode(readFileSync(out))
  const shown = { width, height, data: Uint8Array.from(pixels.data, (_, i) => rgba[Math.floor(i / 3) * 4 + i % 3]) }
  for (const kind of kinds) {
    const score = await ssimulacra2(pixels, shown, { scoreModule: modulesOf(kind).scoreModule })
    // The last digits depend on the instruction set.
    assert(Math.abs(score - native) < 1e-3, `${kind}: ${score} is not the program's ${native}`)
    checks++
  }
  assert(await ssimulacra2(pixels, pixels) == 100)
  // Small pictures are mirrored before they are measured.
  const tiny = generated(7, 9, 3, 8)
  assert(await ssimulacra2(tiny, tiny) == 100 && await ssimulacra2(tiny, { ...tiny, data: tiny.data.map(v => 255 - v) }) < 0)
  await assert.rejects(ssimulacra2(pixels, small), ({ kind, message }) => kind == "parameter" && /differ in width: 768 and 64/.test(message))
}

// Progress is reported, and a cancelled encode ends at once.
const large = generated(600, 400, 3, 8), seen = []
await encode(small, { effort: 1, onProgress: (stage, done) => seen.push([stage, done]) })
assert(seen.length > 2 && seen.every(([stage, done]) => stage && done >= 0 && done <= 1))
let waited = 0
for (const worker of [true, false]) {
  const control = new AbortController()
  let asked
  const stop = () => { asked ??= performance.now(), control.abort(new Error("enough")) }
  const encoding = encode(large, { effort: 9, worker, signal: control.signal, onProgress: worker ? () => setTimeout(stop, 100) : stop })
  await assert.rejects(encoding, /enough/)
  if (worker) waited = performance.now() - asked
}
await assert.rejects(encode(small, { signal: AbortSignal.abort(new Error("before")) }), /before/)
console.log(`cancelled within ${waited.toFixed(1)} ms`)

// Several encodes at the same time give the same files as single ones.
const alone = (await encode(small, { effort: 1 })).bytes
for (const { bytes } of await Promise.all(Array.from({ length: 4 }, () => encode(small, { effort: 1 })))) assert.deepEqual(bytes, alone)

const brotli = file => brotliCompressSync(readFileSync(new URL(file, dist)), { params: { [constants.BROTLI_PARAM_LGWIN]: 24 } }).length
for (const kind of kinds) {
  const size = brotli(`ssplat-score-${kind}.wasm`)
  console.log(`ssplat-score-${kind}.wasm: ${size} bytes as brotli`)
  assert(size <= scoreBudget, `${size} bytes as brotli are more than ${scoreBudget}`)
}
const modules = ["encode.js", "encode-machine.js", "encode-worker.js", "error.js"].reduce((sum, file) => sum + brotli(file), 0)
for (const kind of kinds) {
  const size = brotli(`ssplat-encode-${kind}.wasm`)
  console.log(`ssplat-encode-${kind}.wasm: ${size} bytes as brotli, ${size + modules} with the modules`)
  assert(size <= budgets[kind], `${size} bytes as brotli are more than ${budgets[kind]}`)
}
console.log(`encode: ${checks} files and errors as they should be`)
