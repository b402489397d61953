// The plugins for bundlers and `encodeFile`, from the packed package: node web/test/plugins.mjs [--all | --vite] [PROGRAM] The examples for
// Vite, webpack and Next.js are installed and built twice, the second time without sharp, and shown in Chromium. With --all Next.js is built
// by webpack as well; with --vite only the example for Vite is installed. PROGRAM is the native `ssplat`, by default target/release/ssplat; the files must be the same. With
// SSPLAT_REQUIRE_BROWSER=1 a missing Chromium is a failure, otherwise the browser is named as skipped.
import assert from "node:assert/strict"
import { cpSync, existsSync, mkdirSync, mkdtempSync, readFileSync, readdirSync, renameSync, rmSync, writeFileSync } from "node:fs"
import { createRequire } from "node:module"
import { tmpdir } from "node:os"
import { join } from "node:path"
import { pathToFileURL } from "node:url"
import { inChromium, typeOf } from "./chromium.mjs"
import { test as testEncodeFile } from "./encode-file.js"
import { install, npm, pack } from "./packed.js"
import { test as testVite } from "./vite-plugin.js"

const root = new URL("../../", import.meta.url), isAll = process.argv.includes("--all")
const isViteOnly = process.argv.includes("--vite")
const program = process.argv.slice(2).find(word => !word.startsWith("--")) ?? new URL("target/release/ssplat", root).pathname
const home = mkdtempSync(join(tmpdir(), "ssplat-plugins-"))
process.on("exit", () => rmSync(home, { recursive: true, force: true, maxRetries: 20, retryDelay: 250 }))

// The cache and the output folder of each example, and the messages of its encodes.
const examples = {
  vite: { cache: "node_modules/.vite/ssplat", out: "dist", told: /ssplat: .*photo\.jpg: 96 × 64 pixels in \d+ bytes/g },
  webpack: { cache: "node_modules/.cache/ssplat", out: "dist", told: /<i> .*photo\.jpg: 96 × 64 pixels in \d+ bytes/g },
  next: { cache: "node_modules/.cache/ssplat", out: "out" },
}
const names = isViteOnly ? ["vite"] : Object.keys(examples), folder = name => join(home, name)
const filesIn = (path, end) => readdirSync(path, { recursive: true }).filter(file => file.endsWith(end)).map(file => join(path, file)).sort()

const { filename } = await pack(home)
for (const name of names) cpSync(new URL(`web/examples/${name}/`, root), folder(name), { recursive: true, filter: path => !/node_modules|\/(out|dist|\.next)(\/|$)/.test(path) })
await Promise.all(names.map(name => install(folder(name), join(home, filename))))
await npm(folder("vite"), "install", "--no-audit", "--no-fund", "--no-save", "--no-package-lock", "rollup@4")

const require = createRequire(join(folder("vite"), "package.json")), sharp = require("sharp")
const installed = name => import(pathToFileURL(join(folder("vite"), "node_modules/ssplat", name)).href)
const { encodeFile } = await installed("node.js"), { decode, header } = await installed("ssplat.js")
for (const name of names) await sharp(new URL("tests/images/kodim15.png", root).pathname).resize(96).jpeg().toFile(join(folder(name), "photo.jpg"))

mkdirSync(join(home, "files"))
console.log(`encodeFile: ${await testEncodeFile({ home: join(home, "files"), program, encodeFile, sharp, decode, header })}`)
console.log(`vite-plugin: ${await testVite({ home: join(home, "files"), vite: folder("vite"), program, installed })}`)

// A configuration of Next.js is unchanged except for the loader's rules, even if it is a function.
const { withSsplat } = await installed("next.js")
const configured = await withSsplat(async phase => ({ distDir: phase, turbopack: { rules: { "*.md": "some-loader" } }, webpack: () => ({ module: { rules: [{ loader: "next-image-loader", resourceQuery: { not: [/a/] } }] } }) }))("there")
assert.deepEqual([configured.distDir, configured.turbopack.rules["*.md"]], ["there", "some-loader"])
assert.deepEqual(configured.webpack({}, {}).module.rules[0].resourceQuery.not.map(String), ["/a/", "/[?&]ssplat(&|$)/"])
assert.throws(() => withSsplat({}, { qualty: 70 }), /no option is called qualty/)

// Builds an example, with further arguments for its bundler. Returns the output, and its .ssplat files by their bytes.
async function build(name, ...words) {
  const { out } = examples[name]
  for (const old of [out, ".next"]) rmSync(join(folder(name), old), { recursive: true, force: true })
  const said = await npm(folder(name), "run", "build", ...words)
  return { said, files: filesIn(join(folder(name), out), ".ssplat").map(file => readFileSync(file)).sort(Buffer.compare) }
}

for (const name of names) {
  const { cache, told } = examples[name], sharps = join(folder(name), "node_modules/sharp")
  const first = await build(name)
  assert.equal(first.files.length, 2, `${name}: ${first.files.length} files`)
  for (const file of first.files) {
    const { width, height } = await decode(file)
    assert.deepEqual([width, height], [96, 64], name)
  }
  assert(first.files.some(file => file.length > 2500 && file.length <= 3000), `${name}: no file of the 3000 bytes that were asked for`)
  if (told) assert.equal(first.said.match(told)?.length, 2, `${name}: ${first.said}`)

  // Without sharp nothing can be encoded: so the second build must find everything in its cache.
  renameSync(sharps, `${sharps}-away`)
  const second = await build(name)
  assert.deepEqual(second.files, first.files, `${name}: the second build has other files`)
  if (told) assert(!told.test(second.said), `${name}: the second build encodes: ${second.said}`)
  // One failure for each way to start a loader or a plugin; a build of Next.js takes long.
  if (told) {
    rmSync(join(folder(name), cache), { recursive: true })
    await assert.rejects(npm(folder(name), "run", "build"), /photo\.jpg: pictures are read by the package sharp, which is not installed: npm install sharp/, `${name}: sharp is not missed`)
  }
  renameSync(`${sharps}-away`, sharps)
  console.log(`${name}: ${first.files.map(file => file.length).join(" and ")} bytes, and from the cache`)
}
if (isAll) {
  rmSync(join(folder("next"), examples.next.cache), { recursive: true })
  assert.equal((await build("next", "--", "--webpack")).files.length, 2)
}
// All bundlers give the same files.
const built = names.map(name => filesIn(join(folder(name), examples[name].out), ".ssplat").map(file => readFileSync(file)).sort(Buffer.compare))
for (const files of built) assert.deepEqual(files, built[0])

// The page of Vite fetches the decoder at once, and the service worker lies beside the page.
const vitePage = readFileSync(join(folder("vite"), "dist/index.html"), "utf8"), preloaded = /<link rel="preload" href="(\.\/assets\/ssplat-simd-[^"]+\.wasm)" as="fetch" crossorigin/.exec(vitePage)
assert(preloaded && existsSync(join(folder("vite"), "dist", preloaded[1])), vitePage)
for (const name of names) assert(existsSync(join(folder(name), examples[name].out, "ssplat-service-worker.js")), `${name}: no service worker`)

// The pages, whose .ssplat files are held back until they are released.
let held = Promise.resolve(), release = () => {}
const serve = async url => {
  const { pathname } = new URL(url, "http://localhost"), [, from] = pathname.split("/")
  if (pathname == "/hold") held = new Promise(resolve => release = resolve)
  if (pathname == "/release") release()
  if (pathname == "/hold" || pathname == "/release") return { body: "" }
  const isNext = from == "_next" || names.includes("next") && from == "ssplat-service-worker.js"
  const path = isNext ? join(folder("next"), "out", pathname) : names.includes(from) ? join(folder(from), examples[from].out, pathname.slice(from.length + 2)) : ""
  if (!existsSync(path)) return
  if (path.endsWith(".ssplat")) await held
  return { body: readFileSync(path), headers: { "content-type": typeOf(path) } }
}
const pages = names.map(name => ({ name, url: `/${name}/index.html`, sizes: [[96, 64], [96, 64]], images: 1 }))
const answer = await inChromium(root, "/web/test/placeholder-page.js", pages, { serve })
if (answer) {
  console.log(`Chromium: ${answer.words}`)
  assert.deepEqual(answer.problems, [])
} else if (process.env.SSPLAT_REQUIRE_BROWSER == "1") assert.fail("Chromium is not installed")
else console.log("Chromium: skipped, it is not installed")
