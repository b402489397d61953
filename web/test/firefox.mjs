// The service worker and the element in headless Firefox: node web/test/firefox.mjs [PNG]; .ci/slow calls it. The page with <img>, srcset, <picture>,
// <image>, CSS and the element is shown, at the first visit and later, and compared with the samples of the decoder. With PNG, a screenshot is
// written.
import { writeFileSync } from "node:fs"
import { firefox } from "./marionette.mjs"
import { ids, ready, serve, vector } from "./service-worker.mjs"
import { pixelsOfPng } from "./png.mjs"
import { decode } from "../dist/ssplat.js"

const problems = []
let checks = 0
const check = (good, words) => {
  checks++
  if (!good) problems.push(words)
}
const server = await serve(), browser = await firefox()
if (browser) {
  try {
    const { files, asked, origin } = server, a = files["/a.ssplat"], patience = 60_000
    const until = async expression => {
      for (const end = Date.now() + patience; Date.now() < end; await new Promise(r => setTimeout(r, 50)))
        if (await browser.evaluate(expression).catch(() => false)) return true
      return false
    }
    const expected = (await decode(a)).data
    // Compares places on the screen, where 24 × 16 pixels are shown as they are, with the file.
    const differences = async () => {
      const places = JSON.parse(await browser.evaluate(`JSON.stringify(${JSON.stringify(ids)}.map(id => {
        const { x, y } = document.getElementById(id).getBoundingClientRect()
        return [x, y]
      }))`))
      const { width, channels, data } = pixelsOfPng(Buffer.from(await browser.screenshot(), "base64"))
      return ids.filter((id, i) => {
        const [x, y] = places[i]
        for (let k = 0; k < 24 * 16; k++)
          for (let c = 0; c < 3; c++)
            if (data[((y + Math.floor(k / 24)) * width + x + k % 24) * channels + c] != expected[4 * k + c]) return true
        return false
      })
    }
    const seen = async what => {
      let wrong
      for (let i = 0; i < 50 && (wrong = await differences()).length; i++) await new Promise(r => setTimeout(r, 100))
      check(!wrong.length, `${what}: other pixels are seen in ${wrong}`)
    }

    // The first visit: the pictures fail, the worker starts, and they are loaded again.
    await browser.navigate(`${origin}/first`)
    check(await until(ready), "the worker does not answer the first page")
    check(await browser.evaluate("window.result") === true, "registerSsplat tells that it does not work")
    check(await until(`["src", "srcset", "picture"].every(id => document.getElementById(id).naturalWidth == 24)`), "a picture is missing on the first visit")
    await seen("first visit")
    check(await browser.evaluate(`["broken", "missing", "text"].every(id => !document.getElementById(id).naturalWidth)`), "something broken is shown")
    check(await browser.evaluate(`document.getElementById("png").naturalWidth`) == 768, "a PNG with a wrong name is not shown")
    if (process.argv[2]) writeFileSync(process.argv[2], Buffer.from(await browser.screenshot(), "base64"))

    // A later visit: no script has to load the pictures again, and the browser itself does not ask for them.
    asked.length = 0
    await browser.navigate(`${origin}/first?later`)
    check(await until(ready), "the worker does not answer the second page")
    await seen("second visit")
    const images = asked.filter(({ url, destination }) => url.startsWith("/a.ssplat") && destination == "image")
    check(!images.length, `the browser itself asks for ${images.map(({ url }) => url)} although the worker answers`)

    // A file that has changed is decoded again, and scripts receive the file itself.
    files["/a.ssplat"] = vector("detail-rgb")
    const { width, height } = await decode(files["/a.ssplat"])
    const shown = await browser.evaluate(`new Promise(resolve => {
      const img = document.createElement("img")
      img.onload = img.onerror = () => resolve([img.naturalWidth, img.naturalHeight])
      img.src = "/a.ssplat?changed"
      document.body.append(img)
    })`)
    check(`${shown}` == `${[width, height]}`, `a file that has changed is shown in ${shown}`)
    const bytes = await browser.evaluate(`fetch("/a.ssplat").then(r => r.arrayBuffer()).then(b => Array.from(new Uint8Array(b)))`)
    check(Buffer.compare(Buffer.from(bytes), Buffer.from(files["/a.ssplat"])) == 0, "a script does not receive the file")
  } catch (error) {
    problems.push(error.stack)
  } finally {
    await browser.close()
  }
}
server.close()
for (const problem of problems) console.log(`FAILED: ${problem}`)
console.log(browser ? `Firefox ${browser.version}: ${checks} promises, ${problems.length} failed` : "skipped, there is no Firefox")
process.exit(problems.length || (!browser && process.env.SSPLAT_REQUIRE_BROWSER == "1") ? 1 : 0)
