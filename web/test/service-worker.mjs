// The service worker in headless Chromium: node web/test/service-worker.mjs; package.mjs calls it, too. Pages with <img>, srcset, <picture>,
// <image> and CSS are shown, at the first visit and later, and compared with the samples of the decoder.
import { readFileSync } from "node:fs"
import { createServer } from "node:http"
import { typeOf } from "./chromium.mjs"
import { chromium } from "./cdp.mjs"
import { crc32 } from "./files.js"
import { pixelsOfPng } from "./png.mjs"
import { exif, profile, withSections } from "./sections.js"
import { decode } from "../dist/ssplat.js"

const root = new URL("../../", import.meta.url)
export const vector = name => new Uint8Array(readFileSync(new URL(`spec/vectors/valid/${name}/file.ssplat`, root)))
const patience = 60_000

// An empty picture of another size.
function emptyOf(width, height) {
  const file = vector("coded-empty"), varint = v => v < 128 ? [v] : [v & 127 | 128, ...varint(v >> 7)]
  let end = 6
  for (let i = 0; i < 2; i++) while (file[end++] > 127);
  const body = Uint8Array.from([...file.subarray(0, 6), ...varint(width), ...varint(height), ...file.subarray(end, -4)])
  return Uint8Array.from([...body, ...new Uint8Array(new Uint32Array([crc32(body)]).buffer)])
}

const registered = `<script type="module">import { registerSsplat } from "/web/dist/register.js"
window.result = registerSsplat()</script>`
const first = `<!doctype html><style>
body { margin: 0 } div, img, svg, ssplat-img { display: block }
div { width: 24px; height: 16px }
@media all { #sheet { background: url("/a.ssplat?sheet") } }
</style>
<img id="src" src="/a.ssplat"><img id="srcset" srcset="/a.ssplat?1x 1x, /a.ssplat?2x 2x">
<picture><source srcset="/a.ssplat?source"><img id="picture" src="/missing.png"></picture>
<div id="sheet"></div><div id="inline" style="background: url('/a.ssplat?inline')"></div>
<svg width="24" height="16"><image id="svg" href="/a.ssplat?svg" width="24" height="16"/></svg>
<ssplat-img id="element" src="/a.ssplat?element"></ssplat-img>
<img id="broken" src="/broken.ssplat"><img id="missing" src="/missing.ssplat"><img id="text" src="/text.ssplat">
<img id="png" src="/png.ssplat"><img id="other" src="/tests/images/kodim15.png" width="24">
<script type="module" src="/web/dist/ssplat-img.js"></script>${registered}`
// The places of the page where a picture is seen, and whether it is loaded by the worker.
export const ids = ["src", "srcset", "picture", "sheet", "inline", "svg", "element"]
export const ready = `document.readyState == "complete" && navigator.serviceWorker.controller && document.getElementById("element").complete && document.images[0].naturalWidth`
const pages = {
  "/first": first,
  "/files": `<!doctype html>${registered}`,
  "/own": `<!doctype html><img id="src" src="/a.ssplat"><script type="module">import { registerSsplat } from "/web/dist/register.js"
window.result = registerSsplat({ registration: navigator.serviceWorker.register("/own-worker.js") })</script>`,
}
const scripts = {
  "/ssplat-service-worker.js": () => readFileSync(new URL("web/dist/service-worker.js", root)),
  "/own-worker.js": () => `const kept = 1, Machine = 2
ssplatModule = "/web/dist/ssplat-simd.wasm"
importScripts("/ssplat-service-worker.js")
addEventListener("install", event => event.waitUntil(skipWaiting()))`,
}

// Serves the pages, the scripts and some files; a check may replace the `files`. `asked` are the requests, and `hold` is set to a promise to keep the
// end of /slow.ssplat back.
export async function serve() {
  const a = vector("coded-rgb"), png = readFileSync(new URL("tests/images/kodim15.png", root))
  const files = { "/a.ssplat": a, "/broken.ssplat": a.with(20, a[20] ^ 1), "/png.ssplat": png, "/text.ssplat": "<!doctype html>" }
  const asked = []
  const hold = { until: undefined }
  const server = createServer(async (request, response) => {
    const { pathname } = new URL(request.url, "http://localhost"), found = files[pathname]
    asked.push({ url: request.url, destination: request.headers["sec-fetch-dest"], range: request.headers.range })
    try {
      if (pages[pathname]) return response.writeHead(200, { "content-type": "text/html" }).end(pages[pathname])
      const type = pathname == "/text.ssplat" ? "text/html" : typeOf(pathname), headers = { "content-type": type, "cache-control": "no-cache" }
      if (request.headers.host.startsWith("localhost") && pathname != "/closed.ssplat") headers["access-control-allow-origin"] = "*"
      if (pathname == "/slow.ssplat") {
        const file = vector("groups-divided")
        response.writeHead(200, headers).write(file.subarray(0, 3000))
        await hold.until
        return response.end(file.subarray(3000))
      }
      const body = found ?? scripts[pathname]?.() ?? readFileSync(new URL(`.${pathname}`, root))
      response.writeHead(200, headers).end(body)
    } catch {
      response.writeHead(404).end()
    }
  })
  await new Promise(resolve => server.listen(0, resolve))
  const { port } = server.address(), origin = `http://127.0.0.1:${port}`
  const close = () => {
    server.closeAllConnections()
    server.close()
  }
  return { files, asked, hold, port, origin, close }
}

export async function test() {
  const problems = []
  let checks = 0
  const check = (good, words) => {
    checks++
    if (!good) problems.push(words)
  }
  const { files, asked, hold, port, origin, close: closeServer } = await serve()
  const a = files["/a.ssplat"]
  const responses = []
  const browser = await chromium(({ method, params }) => { if (method == "Network.responseReceived") responses.push(params.response) })
  if (!browser) return closeServer()
  try {
    const until = async (page, expression) => {
      for (const end = Date.now() + patience; Date.now() < end; await new Promise(r => setTimeout(r, 50)))
        if (await page.evaluate(expression).catch(() => false)) return true
      return false
    }
    // Shows a file by <img>, and returns the size of the picture; 0 if it cannot be shown.
    const show = (page, url) => page.evaluate(`new Promise(resolve => {
      const img = document.createElement("img")
      img.onload = img.onerror = () => resolve([img.naturalWidth, img.naturalHeight])
      img.src = ${JSON.stringify(url)}
      document.body.append(img)
    })`)
    // Returns the cached PNG of a file.
    const stored = async (page, file) => {
      const hash = Buffer.from(await crypto.subtle.digest("SHA-256", file)).toString("hex")
      const text = await page.evaluate(`(async () => {
        const response = await caches.match("/ssplat-png/${hash}", { ignoreSearch: true }), reader = new FileReader
        if (!response) return ""
        reader.readAsDataURL(await response.blob())
        return new Promise(resolve => reader.onload = () => resolve(reader.result))
      })()`)
      return text && Buffer.from(text.split(",")[1], "base64")
    }
    const expected = (await decode(a)).data
    // Compares places on the screen, where 24 × 16 pixels are shown as they are, with a file.
    const differences = async (page, ids) => JSON.parse(await page.evaluate(`(async () => {
      const png = await createImageBitmap(await (await fetch("data:image/png;base64,${await page.screenshot()}")).blob())
      const context = new OffscreenCanvas(png.width, png.height).getContext("2d"), expected = ${JSON.stringify([...expected])}
      context.drawImage(png, 0, 0)
      return JSON.stringify(${JSON.stringify(ids)}.filter(id => {
        const { x, y } = document.getElementById(id).getBoundingClientRect()
        return context.getImageData(x, y, 24, 16).data.some((v, i) => v != expected[i])
      }))
    })()`))

    // The first visit: the pictures fail, the worker starts, and they are loaded again.
    const page = await browser.page(`${origin}/first`, ask => ask("Network.enable"))
    check(await until(page, ready), "the worker does not answer the first page")
    check(await page.evaluate("window.result") === true, "registerSsplat tells that it does not work")
    check(await until(page, `["src", "srcset", "picture"].every(id => document.getElementById(id).naturalWidth == 24)`), "a picture is missing on the first visit")
    const seen = async what => {
      for (let i = 0; i < 20 && (await differences(page, ids)).length; i++) await new Promise(r => setTimeout(r, 100))
      const wrong = await differences(page, ids)
      check(!wrong.length, `${what}: other pixels are seen in ${wrong}`)
    }
    await seen("first visit")
    check(await page.evaluate(`["broken", "missing", "text"].every(id => document.getElementById(id).complete && !document.getElementById(id).naturalWidth)`), "something broken is shown")
    check(await page.evaluate(`document.getElementById("png").naturalWidth`) == 768, "a PNG with a wrong name is not shown")
    check(asked.filter(({ url }) => url == "/broken.ssplat").length <= 2, "a broken file is asked for again and again")
    check(asked.filter(({ url, destination }) => url == "/a.ssplat?element" && destination == "empty").length == 1, "the element does not fetch the file itself")

    // Later visits: from the cache, which is proven by another picture in it.
    asked.length = 0
    await page.ask("Page.reload")
    await until(page, `${ready} && performance.getEntriesByType("navigation")[0].type == "reload"`)
    await seen("second visit")
    const images = asked.filter(({ destination }) => destination == "image").map(({ url }) => url)
    check(!images.some(url => url.startsWith("/a.ssplat")), "the browser itself asks for a picture although the worker answers")
    const other = responses.findLast(({ url }) => url.endsWith("/kodim15.png"))
    check(other.serviceWorkerRouterInfo?.actualSourceType == "network", `other pictures pass the worker: ${JSON.stringify(other.serviceWorkerRouterInfo)}`)
    // A forced reload goes past the worker.
    await page.ask("Page.reload", { ignoreCache: true })
    check(await until(page, `window.result && ${ready}`), "nothing is shown after a forced reload")
    await seen("forced reload")
    await page.evaluate(`(async () => {
      const cache = await caches.open("ssplat-png-1"), [key] = await cache.keys(), response = await fetch("/tests/images/kodim15.png")
      await cache.put(key, new Response(await response.blob()))
    })()`)
    check(`${await show(page, "/a.ssplat?again")}` == "768,512", "the cache is not used")
    // A file that has changed is decoded again.
    files["/a.ssplat"] = vector("detail-rgb")
    const { width, height } = await decode(files["/a.ssplat"])
    check(`${await show(page, "/a.ssplat?changed")}` == `${[width, height]}` && `${[width, height]}` != "24,16", "a file that has changed is shown as it was")

    // Scripts receive the file itself, also in parts, and a script's Range is passed on.
    const bytes = await page.evaluate(`fetch("/a.ssplat").then(r => r.arrayBuffer()).then(b => Array.from(new Uint8Array(b)))`)
    check(Buffer.compare(Buffer.from(bytes), Buffer.from(files["/a.ssplat"])) == 0, "a script does not receive the file")
    let release
    hold.until = new Promise(resolve => release = resolve)
    await page.evaluate(`document.body.prepend(Object.assign(document.createElement("ssplat-img"), { id: "slow", src: "/slow.ssplat" }))`)
    check(await until(page, `!document.getElementById("slow").shadowRoot.querySelector("canvas").hidden`), "the element does not stream")
    check(!await page.evaluate(`document.getElementById("slow").complete`), "half a file is complete")
    release()
    check(await until(page, `document.getElementById("slow").complete`), "the element does not load")

    // Another origin, with and without CORS.
    files["/closed.ssplat"] = a
    check(`${await show(page, `http://localhost:${port}/broken.ssplat`)}` == "0,0", "a broken file of another origin is shown")
    check(`${await show(page, `http://localhost:${port}/a.ssplat`)}` == `${[width, height]}`, "a file of another origin is not shown")
    check(`${await show(page, `http://localhost:${port}/closed.ssplat`)}` == "0,0", "a file of another origin is read without permission")
    await page.close()

    // Samples, channels, profile and orientation of the PNG.
    const more = await browser.page(`${origin}/files`)
    check(await until(more, "navigator.serviceWorker.controller"), "the worker does not answer a page without pictures")
    const profiled = profile([[.5, .2, 0], [.3, .7, .1], [.1, .1, .7]])
    const cases = Object.fromEntries(["coded-rgb", "coded-grey", "coded-grey-alpha", "coded-rgba", "exact-rgba-16", "exact-grey-16", "detail-rgb", "coded-dot"].map(name => [name, vector(name)]))
    for (let orientation = 1; orientation <= 8; orientation++) cases[`orientation-${orientation}`] = withSections(a, { exif: exif(orientation), ...orientation == 6 && { iccp: profiled } })
    for (const [name, file] of Object.entries(cases)) {
      files[`/${name}.ssplat`] = file
      const { width: w, height: h, data, channels, orientation, icc } = await decode(file), turned = orientation > 4 ? [h, w] : [w, h]
      check(`${await show(more, `/${name}.ssplat`)}` == `${turned}`, `${name}: not shown in ${turned}`)
      // The picture is put into the cache after the answer.
      let made
      for (const end = Date.now() + patience; Date.now() < end && !(made = await stored(more, file)); await new Promise(r => setTimeout(r, 50)));
      check(made, `${name}: not in the cache`)
      if (!made) continue
      const picture = pixelsOfPng(made)
      check(picture.channels == channels && Buffer.compare(Buffer.from(picture.icc ?? []), Buffer.from(icc)) == 0, `${name}: ${picture.channels} channels, a profile of ${picture.icc?.length} bytes`)
      const from = [, (x, y) => [x, y], (x, y) => [w - 1 - x, y], (x, y) => [w - 1 - x, h - 1 - y], (x, y) => [x, h - 1 - y], (x, y) => [y, x], (x, y) => [y, h - 1 - x], (x, y) => [w - 1 - y, h - 1 - x], (x, y) => [w - 1 - y, x]][orientation]
      const same = picture.data.every((v, i) => {
        const k = i % channels, place = (i - k) / channels, [x, y] = from(place % turned[0], Math.floor(place / turned[0]))
        return v == data[4 * (y * w + x) + (channels < 3 && k == 1 ? 3 : k)]
      })
      check(same, `${name}: other samples than the decoder's`)
    }
    // Large pictures are reduced, and the cache stays below its limit.
    for (const [w, h] of [[8192, 4096], [8000, 4000]]) {
      const file = files["/large.ssplat"] = emptyOf(w, h), [columns, rows] = await show(more, `/large.ssplat?${w}`)
      check(columns * rows <= 2 ** 24 && columns * rows > .99 * 2 ** 24 && Math.abs(columns / rows - 2) < .01, `${w} × ${h} are shown as ${columns} × ${rows}`)
      check(await until(more, `caches.open("ssplat-png-1").then(c => c.keys()).then(keys => keys.some(({ url }) => url.includes("${Buffer.from(await crypto.subtle.digest("SHA-256", file)).toString("hex")}")))`), "a large picture is not in the cache")
    }
    check(await until(more, `caches.open("ssplat-png-1").then(c => c.keys()).then(keys => keys.reduce((sum, { url }) => sum + Number(new URL(url).search.slice(1)), 0) <= 2 ** 26)`), "the cache grows without limit")
    await more.close()

    // The service worker of an application imports the script, with names of its own.
    files["/a.ssplat"] = a
    const own = await browser.page(`${origin}/own`)
    check(await until(own, "document.images[0].naturalWidth == 24"), "a service worker that imports the script shows nothing")
    await own.close()
  } catch (error) {
    problems.push(error.stack)
  } finally {
    await browser.close()
    closeServer()
  }
  return { problems, words: `${checks} promises` }
}

if (process.argv[1] == new URL(import.meta.url).pathname) {
  const result = await test()
  for (const problem of result?.problems ?? []) console.log(`FAILED: ${problem}`)
  console.log(`service worker: ${result ? `${result.words}, ${result.problems.length} failed` : "skipped, there is no Chromium"}`)
  process.exit(result?.problems.length || (!result && process.env.SSPLAT_REQUIRE_BROWSER == "1") ? 1 : 0)
}
