// Tests the plugin for Vite and Rollup beyond its example: options, errors, the cache, and the development server.
import assert from "node:assert/strict"
import { execFileSync } from "node:child_process"
import { randomUUID } from "node:crypto"
import { cpSync, existsSync, mkdirSync, readFileSync, readdirSync, rmSync, statSync, truncateSync, utimesSync, writeFileSync } from "node:fs"
import { request } from "node:http"
import { createRequire } from "node:module"
import { basename, dirname, join } from "node:path"
import { pathToFileURL } from "node:url"

// `home` has the pictures of encode-file.js; `vite` is a folder where Vite is installed.
export async function test({ home, vite, program, installed }) {
  const { build, createServer, createLogger } = await import(pathToFileURL(createRequire(join(vite, "package.json")).resolve("vite")).href)
  const { default: ssplat } = await installed("vite.js")
  const entry = join(home, "entry.js"), cacheDir = join(home, "cache"), encoded = []
  const customLogger = createLogger("silent")
  customLogger.info = words => { if (/^ssplat: .* pixels in /.test(words)) encoded.push(words) }
  const config = options => ({ root: home, configFile: false, logLevel: "silent", customLogger, cacheDir, plugins: [ssplat(options)] })

  // Builds a module that exports the imports of `requests`; returns them with the emitted bytes.
  async function imported(requests, options) {
    writeFileSync(entry, requests.map((request, i) => `export { default as p${i} } from "${request}"`).join("\n"))
    const [{ output }] = [await build({ ...config(options), build: { write: false, lib: { entry, formats: ["es"] }, rollupOptions: { output: { assetFileNames: "[name]-[hash][extname]" } } } })].flat()
    const path = join(home, `built-${Math.random()}.mjs`)
    writeFileSync(path, output.find(file => file.type == "chunk").code)
    const pictures = Object.values(await import(pathToFileURL(path).href)), assets = output.filter(file => file.type == "asset")
    return { assets, pictures: pictures.map(picture => ({ ...picture, bytes: assets.find(({ fileName }) => decodeURI(picture.src).endsWith(fileName))?.source })) }
  }
  const native = args => {
    execFileSync(program, ["encode", "--quiet", join(home, "rgb.png"), join(home, "native.ssplat"), ...args])
    return readFileSync(join(home, "native.ssplat"))
  }

  // Imports of a picture with different options give different files; a repeated import does not.
  const requests = ["./rgb.png?effort=1&ssplat", "./rgb.png?ssplat&bytes=700&effort=1&placeholder=0", "./rgb.png?ssplat&effort=1"]
  const { assets, pictures: [plain, small, again] } = await imported(requests)
  assert.equal(assets.length, 2)
  assert.deepEqual(again, plain)
  assert(Buffer.compare(native(["--effort", "1"]), plain.bytes) == 0 && Buffer.compare(native(["--effort", "1", "--bytes", "700"]), small.bytes) == 0, "other bytes than the program's")
  assert.deepEqual([plain.width, plain.height, small.placeholder], [72, 48, ""])
  assert(/^data:image\/x-ssplat;base64,iVNTUA/.test(plain.placeholder), plain.placeholder)
  assert.equal(encoded.splice(0).length, 2)

  // A second build encodes nothing; incomplete cache entries are encoded again.
  await imported(requests)
  assert.deepEqual(encoded.splice(0), [])
  for (const key of readdirSync(join(cacheDir, "ssplat"))) truncateSync(join(cacheDir, "ssplat", key, "rgb.ssplat"), 100)
  assert.deepEqual((await imported(requests)).pictures, [plain, small, again])
  assert.equal(encoded.splice(0).length, 2)
  assert(readdirSync(join(cacheDir, "ssplat")).every(key => /^[0-9a-f]{32}$/.test(key)), "drafts stay in the cache")
  // Another picture of the same name is another file.
  cpSync(join(home, "palette.png"), join(home, "rgb.png"))
  const [other] = (await imported(["./rgb.png?effort=1&ssplat"])).pictures
  assert(encoded.splice(0).length == 1 && Buffer.compare(native(["--effort", "1"]), other.bytes) == 0, "the cache does not know pictures by their content")

  // The options of the plugin are defaults; a target in the query takes the place of theirs.
  const [ofPlugin, ofQuery] = (await imported(["./rgb.png?ssplat", "./rgb.png?ratio=30&ssplat"], { bytes: 600, effort: 1, cacheDir: "other" })).pictures
  assert(Buffer.compare(native(["--effort", "1", "--bytes", "600"]), ofPlugin.bytes) == 0 && Buffer.compare(native(["--effort", "1", "--ratio", "30"]), ofQuery.bytes) == 0, "defaults are not kept")
  assert.equal(readdirSync(join(home, "other")).length, 2)
  assert.throws(() => ssplat({ qualty: 70 }), /no option is called qualty/)

  // Any picture name is converted to a file name that is safe in a URL.
  cpSync(join(home, "rgb.png"), join(home, "my photo 100% ü.png"))
  const [named] = (await imported(["./my photo 100% ü.png?effort=1&ssplat"])).pictures
  assert(Buffer.compare(other.bytes, named.bytes) == 0, named.src)
  encoded.splice(0)

  const fails = (request, words) => assert.rejects(imported([request]), error => {
    assert(words.test(error.message), `${request}: ${error.message}`)
    return true
  })
  await fails("./rgb.png?effort=12&ssplat", /rgb\.png\?effort=12&ssplat: effort is 12, not an integer from 1 to 9/)
  await fails("./rgb.png?ssplat&effort=fast", /rgb\.png\?ssplat&effort=fast: effort is fast/)
  await fails("./rgb.png?ssplat&qualty=70", /rgb\.png\?ssplat&qualty=70: no option is called qualty; there are ratio, /)
  await fails("./rgb.png?ssplat&effort", /rgb\.png\?ssplat&effort: effort has no value/)
  await fails("./rgb.png?ssplat&effort=1&effort=2", /effort is given twice/)
  await fails("./rgb.png?ssplat&ratio=50&bytes=500", /rgb\.png.*: ratio and bytes are given/)
  await fails("./rgb.png?ssplat&tune=best&effort=1", /rgb\.png.*: tune is best, none of psnr, iq/)
  await fails("./rgb.png?ssplat&effort=1&bytes=5", /rgb\.png\?ssplat&effort=1&bytes=5: 5 bytes cannot hold the picture/)
  await fails("./cut.jpg?ssplat", /cut\.jpg: .*premature end/i)
  await fails("./text.jpg?ssplat", /text\.jpg: .*unsupported/)
  await fails("./missing.jpg?ssplat", /missing\.jpg/)

  // Rollup does not handle assets, so the plugin emits the file, and the module contains its URL.
  const { rollup } = await import(pathToFileURL(createRequire(join(vite, "package.json")).resolve("rollup")).href)
  writeFileSync(entry, `export { default } from "./rgb.png?ssplat"`)
  const bundle = await rollup({ input: entry, onLog() {}, plugins: [ssplat({ effort: 1, cacheDir })] })
  const { output: [{ code }, asset] } = await bundle.generate({ format: "es" })
  assert(/^assets\/rgb-[\w-]+\.ssplat$/.test(asset.fileName) && code.includes(`new URL('${asset.fileName}', import.meta.url).href`), code)
  assert(Buffer.compare(native(["--effort", "1"]), asset.source) == 0, "Rollup emits other bytes than the program's")

  // A file of the project, devices and folders; and cache entries that no build uses any more.
  const { importPicture } = await installed("import-picture.js"), aged = join(home, "aged"), into = path => importPicture(path, "ssplat", { cacheDir: aged, defaults: { effort: 1 } }, () => {})
  const entries = { ["0".repeat(32)]: 91, [`${"1".repeat(32)}-${randomUUID()}`]: 91, ["2".repeat(32)]: 89, "another-folder": 91 }
  for (const [name, days] of Object.entries(entries)) {
    mkdirSync(join(aged, name), { recursive: true })
    utimesSync(join(aged, name), new Date(), new Date(Date.now() - days * 86_400_000))
  }
  const { file } = await into(join(home, "rgb.png"))
  assert.deepEqual(readdirSync(aged).sort(), ["2".repeat(32), "another-folder", basename(dirname(file))].sort())
  utimesSync(dirname(file), new Date(0), new Date(0))
  await into(join(home, "rgb.png"))
  assert(Date.now() - statSync(dirname(file)).mtimeMs < 60_000, "the use of an entry is not recorded")
  await assert.rejects(into(home), /ssplat: not a file/)
  if (existsSync("/dev/zero")) await assert.rejects(into("/dev/zero"), /zero\?ssplat: not a file/)
  truncateSync(join(home, "cut.jpg"), 2 ** 30 + 1)
  await assert.rejects(into(join(home, "cut.jpg")), /1073741825 bytes are more than the 1073741824/)

  // The development server: files are served below its base, also from a cache outside the project, and a picture that changes is encoded again.
  const outside = `${home}-outside`, secret = `${home}-secret`
  mkdirSync(secret)
  for (const path of [join(secret, "s.png"), join(home, ".env.png")]) cpSync(join(home, "palette.png"), path)
  writeFileSync(join(home, "page.js"), `import a from "./my photo 100% ü.png?ssplat"\nimport b from "./rgb.png?ssplat"\nconsole.log(a, b)`)
  writeFileSync(join(home, "denied.js"), `import a from "./.env.png?ssplat"\nconsole.log(a)`)
  const server = await createServer({ ...config({ effort: 1, cacheDir: outside }), base: "/base/", server: { host: "127.0.0.1", ws: false, fs: { strict: true, allow: [home, outside] } } })
  try {
    await server.listen()
    const { port } = server.httpServer.address(), origin = `http://127.0.0.1:${port}`
    // `path` is sent as it is, with `..`.
    const get = path => new Promise((resolve, reject) => request({ host: "127.0.0.1", port, path, agent: false }, async answer => {
      resolve({ status: answer.statusCode, text: Buffer.concat(await answer.toArray()).toString() })
    }).on("error", reject).end())
    const refused = async path => {
      const { status, text } = await get(path)
      assert(status >= 400, `${path}: ${status} ${text}`)
      return text
    }

    // The service worker and its WebAssembly lie at the base.
    for (const [name, file] of [["ssplat-service-worker.js", "service-worker.js"], ["ssplat-simd.wasm", "ssplat-simd.wasm"]]) {
      const answer = await fetch(`${origin}/base/${name}`)
      assert(answer.ok && Buffer.compare(Buffer.from(await answer.arrayBuffer()), readFileSync(join(vite, "node_modules/ssplat", file))) == 0, `${name}: ${answer.status}`)
    }

    // Before a module that imports the picture is sent, nobody can have it encoded.
    await refused("/base/rgb.png?import&ssplat")
    const { text: page } = await get("/base/page.js"), [named, plain] = [...page.matchAll(/from "([^"]*[?&]ssplat[^"]*)"/g)].map(([, url]) => url)
    const fetched = async url => (await fetch(new URL(url, origin))).text()
    const ask = async url => {
      const text = await fetched(url), source = /from "([^"]+\.ssplat\?[^"]+)"/.exec(text)?.[1]
      assert(source, `${url}: ${text}`)
      const path = /export default "([^"]+)"/.exec(await fetched(source))[1], answer = await fetch(new URL(path, origin))
      assert.equal(answer.status, 200, path)
      return Buffer.from(await answer.arrayBuffer())
    }
    // As the name has a "%", which Vite does not escape.
    await ask(encodeURI(named))
    const before = await ask(plain)
    assert(Buffer.compare(native(["--effort", "1"]), before) == 0, "the server serves other bytes than the program's")

    // Other pictures, other options, and files outside of what Vite serves: nothing is encoded, and the answers do not tell which files exist.
    const entries = readdirSync(outside).length, up = `/base/${"../".repeat(20)}`
    for (const path of [`/base/@fs${secret}/s.png`, `${up.slice(0, -1)}${secret}/s.png`, "/base/grey.png", "/base/text.jpg", "/base/.env.png"])
      for (const options of ["ssplat", "effort=1&ssplat&quality=95"]) {
        const [said, other] = await Promise.all([path, path.replace(/(\w+)(?=\.\w+$)/, "none")].map(path => refused(`${path}?import&${options}`)))
        assert.equal(said.replace(/\b(s|grey|text|env)\./g, "none."), other.replace(/\b(s|grey|text|env)\./g, "none."))
      }
    for (const options of ["seed=7", "effort=9", "quality=95", "maxSide=10", "placeholder=0"]) await refused(`/base/rgb.png?import&ssplat&${options}`)
    // What Vite denies is denied to the project's modules as well.
    await get("/base/denied.js")
    assert.match(await refused("/base/.env.png?import&ssplat"), /\.env\.png: Vite may not serve this file/)
    assert.equal(readdirSync(outside).length, entries, "a request has filled the cache")

    cpSync(join(home, "grey.png"), join(home, "rgb.png"))
    let after
    for (let i = 0; i < 600 && !(after && Buffer.compare(before, after)); i++) {
      await new Promise(r => setTimeout(r, 100))
      after = await ask(plain)
    }
    assert(Buffer.compare(native(["--effort", "1"]), after) == 0, "a picture that changed is served as it was")
  } finally {
    await server.close()
    for (const folder of [cacheDir, outside, secret]) rmSync(folder, { recursive: true, force: true })
  }
  return "options, errors, cache and server"
}
