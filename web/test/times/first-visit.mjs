// Measures when a page shows its picture on the first visit, at 1.6 Mbit/s and 150 ms (Lighthouse's slow 4G), in milliseconds from the start of
// the navigation: node web/test/times/first-visit.mjs FILE.ssplat [PICTURE.avif ...] [--runs N]
// The other pictures are shown by <img>, for comparison. Scripts and WebAssembly are served with brotli. Each run has a profile of its own in one
// browser process; the first run of each page is left out. Other programs on the machine delay the times, the least of them least. Chromium
// throttles pages and service workers separately, and the server speaks HTTP/1.1, with up to six requests at a time.
import { readFileSync, statSync } from "node:fs"
import { createServer } from "node:http"
import { basename } from "node:path"
import { brotliCompressSync } from "node:zlib"
import { chromium } from "../cdp.mjs"
import { typeOf } from "../chromium.mjs"

const at = process.argv.indexOf("--runs"), runs = at < 0 ? 5 : Number(process.argv[at + 1])
const files = process.argv.slice(2, at < 0 ? undefined : at), [ours] = files
const dist = new URL("../../dist/", import.meta.url)
const conditions = { offline: false, latency: 150, downloadThroughput: 1.6e6 / 8, uploadThroughput: 750e3 / 8 }

// Two frames after `load`, the picture has been painted.
const seen = `<script>
const painted = () => requestAnimationFrame(() => requestAnimationFrame(() => window.seen ??= performance.now()))
const watch = picture => picture.addEventListener("load", () => picture.decode().then(painted))
</script>`
const modules = ["ssplat-img.js", "placeholder.js", "ssplat.js", "source.js", "machine.js", "error.js", "icc.js"]
const links = [
  `<link rel="preload" href="/ssplat/ssplat-simd.wasm" as="fetch" crossorigin>`,
  ...modules.map(name => `<link rel="modulepreload" href="/ssplat/${name}">`),
  `<link rel="preload" href="/${basename(ours)}" as="fetch" crossorigin>`,
].join("")
const size = `width="768" height="512"`
const shown = {
  element: name => `<ssplat-img id="picture" src="/${name}" ${size}></ssplat-img><script>watch(picture)</script><script type="module" src="/ssplat/ssplat-img.js"></script>`,
  img: name => `<img id="picture" src="/${name}" ${size}><script>watch(picture)</script>`,
}
const worker = `<script type="module">import { registerSsplat } from "/ssplat/register.js"; registerSsplat()</script>`
const pages = {
  ...Object.fromEntries(files.slice(1).map(file => [`<img>, ${basename(file)}`, { html: shown.img(basename(file)) }])),
  "<ssplat-img>": { html: shown.element(basename(ours)) },
  "<ssplat-img>, preload and modulepreload": { html: links + shown.element(basename(ours)) },
  "<img>, service worker": { html: shown.img(basename(ours)) + worker },
  "<img>, service worker, preload": { html: `${links.split(">")[0]}><link rel="modulepreload" href="/ssplat/register.js">${shown.img(basename(ours))}${worker}` },
  "<ssplat-img>, second visit, another picture": { html: shown.element("other.ssplat"), before: "<ssplat-img>" },
  "<img>, service worker, second visit, another picture": { html: shown.img("other.ssplat") + worker, before: "<img>, service worker" },
}
const names = Object.keys(pages), html = name => `<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">${seen}${pages[name].html}`

const compressed = new Map
const server = createServer((request, response) => {
  const path = new URL(request.url, "http://localhost").pathname, send = (body, headers) => response.writeHead(200, { "cache-control": "max-age=3600", ...headers }).end(body)
  if (/^\/page\d+$/.test(path)) return send(html(names[path.slice(5)]), { "content-type": "text/html" })
  const file = path == "/other.ssplat" ? ours : files.find(file => `/${basename(file)}` == path)
  if (file) return send(readFileSync(file), { "content-type": file.endsWith(".ssplat") ? "image/x-ssplat" : `image/${file.split(".").pop()}` })
  try {
    const name = path.replace(/^\/(ssplat\/|ssplat-(?=service-worker))/, "")
    if (!compressed.has(name)) compressed.set(name, brotliCompressSync(readFileSync(new URL(name, dist))))
    send(compressed.get(name), { "content-type": typeOf(name), "content-encoding": "br" })
  } catch {
    response.writeHead(404).end()
  }
})
await new Promise(resolve => server.listen(0, "127.0.0.1", resolve))
const origin = `http://127.0.0.1:${server.address().port}`

let bytes = 0
const browser = await chromium(({ method, params }) => {
  if (method == "Network.loadingFinished") bytes += params.encodedDataLength
  if (method != "Target.attachedToTarget") return
  // Service workers are throttled as well, before their first request.
  for (const [name, values] of [["Network.enable"], ["Network.emulateNetworkConditions", conditions], ["Runtime.runIfWaitingForDebugger"]])
    browser.send(name, values, params.sessionId).catch(() => {})
}, 600_000)
if (!browser) throw new Error("there is no Chromium")
await browser.send("Target.setAutoAttach", { autoAttach: true, waitForDebuggerOnStart: true, flatten: true, filter: [{ type: "service_worker" }] })

// Opens a page and returns when its picture was seen.
async function visit(page, name) {
  await page.ask("Page.navigate", { url: `${origin}/page${names.indexOf(name)}` })
  for (let i = 0; i < 1000; i++) {
    const time = await page.evaluate(`location.pathname == "/page${names.indexOf(name)}" && window.seen`).catch(() => 0)
    if (time) return time
    await new Promise(r => setTimeout(r, 20))
  }
  throw new Error(`${name}: nothing is seen`)
}

try {
  for (const file of files) console.log(`${basename(file)}: ${statSync(file).size} bytes`)
  for (const name of names) {
    const times = [], sizes = []
    for (let run = 0; run <= runs; run++) {
      const page = await browser.page("about:blank", async ask => {
        await ask("Network.enable")
        await ask("Network.emulateNetworkConditions", conditions)
      })
      if (pages[name].before) await visit(page, pages[name].before)
      bytes = 0
      const time = await visit(page, name)
      if (run) times.push(time), sizes.push(bytes)
      await page.close()
    }
    times.sort((a, b) => a - b)
    console.log(`${name}: ${times[0].toFixed(0)} ms at the least, ${times[times.length >> 1].toFixed(0)} in the middle, ${(Math.max(...sizes) / 1000).toFixed(0)} kB`)
  }
} finally {
  await browser.close()
  server.closeAllConnections()
  server.close()
}
