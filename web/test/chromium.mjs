// Opens a page in headless Chromium and returns the result of its module's `test`; undefined if there is no Chromium.
import { spawn } from "node:child_process"
import { mkdtempSync, readFileSync, rmSync } from "node:fs"
import { createServer } from "node:http"
import { tmpdir } from "node:os"
import { join } from "node:path"
import { end } from "./browser.mjs"

const types = { html: "text/html", js: "text/javascript", mjs: "text/javascript", wasm: "application/wasm", png: "image/png", css: "text/css" }
// Not a test of speed: a page that never answers is a failure.
const patience = 240_000

export const typeOf = path => types[path.split(".").pop()] ?? "application/octet-stream"

// `test` is called with `given` and `more`. WebGPU is available only with `webgpu`. `serve` answers requests for paths outside the
// repository: {body, headers}, or undefined.
export async function inChromium(root, module, given, { webgpu = false, more = {}, serve = () => {} } = {}) {
  const home = mkdtempSync(join(tmpdir(), "ssplat-chromium-"))
  let finish
  const answer = new Promise(resolve => finish = resolve)
  const page = `<!doctype html><meta charset=utf-8><title>test</title><body><script type=module>
const say = body => fetch("/answer", { method: "POST", body: JSON.stringify(body) })
addEventListener("unhandledrejection", e => say({ problems: [String(e.reason?.stack ?? e.reason)], words: "stopped" }))
try {
  const { test } = await import(${JSON.stringify(module)})
  await say(await test(...${JSON.stringify([given, more])}))
} catch (error) {
  await say({ problems: [String(error.stack)], words: "stopped" })
}
</script>`
  const server = createServer(async (request, response) => {
    const path = new URL(request.url, "http://localhost").pathname
    if (path == "/answer") {
      const chunks = []
      request.on("data", chunk => chunks.push(chunk)).on("end", () => {
        response.end()
        finish(JSON.parse(Buffer.concat(chunks)))
      })
      return
    }
    try {
      if (path == "/") return response.writeHead(200, { "content-type": "text/html" }).end(page)
      const served = await serve(request.url)
      if (served) return response.writeHead(200, { "content-type": typeOf(path), ...served.headers }).end(served.body)
      // Only files of the repository.
      if (!/^\/(web|spec|tests\/images)\//.test(path)) throw new Error(path)
      const body = readFileSync(new URL(`.${path}`, root))
      response.writeHead(200, { "content-type": typeOf(path) }).end(body)
    } catch {
      response.writeHead(404).end()
    }
  })
  await new Promise(resolve => server.listen(0, "127.0.0.1", resolve))
  const software = ["--use-vulkan=swiftshader", "--enable-features=Vulkan", "--use-angle=swiftshader", "--use-webgpu-adapter=swiftshader"]
  const graphics = webgpu ? [...software, "--enable-unsafe-webgpu", "--ignore-gpu-blocklist"] : ["--disable-gpu"]
  const options = ["--headless=new", "--no-sandbox", ...graphics, "--enable-unsafe-swiftshader", "--disable-dev-shm-usage", "--no-first-run", "--window-size=1000,800", `--user-data-dir=${home}`]
  const browser = spawn(process.env.CHROMIUM ?? "chromium", [...options, `http://127.0.0.1:${server.address().port}/`], { stdio: "ignore", detached: true })
  const ended = new Promise(resolve => browser.on("exit", resolve).on("error", resolve))
  browser.on("error", () => finish(undefined))
  browser.on("exit", code => finish({ problems: [`Chromium ended with ${code}`], words: "stopped" }))
  const alarm = setTimeout(() => finish({ problems: [`no answer in ${patience / 1000} s`], words: "hung" }), patience)
  const result = await answer
  clearTimeout(alarm)
  await end(browser, ended)
  server.closeAllConnections()
  server.close()
  // Its children may still be writing.
  try {
    rmSync(home, { recursive: true, force: true, maxRetries: 20, retryDelay: 250 })
  } catch (error) {
    console.log(`left behind: ${error.path}`)
  }
  return result
}
