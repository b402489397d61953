// Headless Chromium under the DevTools protocol: pages, their targets (workers, service workers), the network and screenshots.
import { spawn } from "node:child_process"
import { mkdtempSync, rmSync } from "node:fs"
import { tmpdir } from "node:os"
import { join } from "node:path"
import { end } from "./browser.mjs"

// Starts Chromium; returns undefined if it is not installed. `onEvent` is called with {method, params, sessionId}. After `patience` milliseconds
// all requests fail.
export async function chromium(onEvent = () => {}, patience = 120_000) {
  const home = mkdtempSync(join(tmpdir(), "ssplat-cdp-"))
  const options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run", "--hide-scrollbars", "--remote-debugging-pipe", `--user-data-dir=${home}`]
  const browser = spawn(process.env.CHROMIUM ?? "chromium", [...options, "about:blank"], { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"], detached: true })
  const started = await new Promise(resolve => browser.on("spawn", () => resolve(true)).on("error", () => resolve(false)))
  if (!started) {
    rmSync(home, { recursive: true, force: true })
    return
  }
  const ended = new Promise(resolve => browser.on("exit", resolve)), waiting = new Map
  let count = 0, rest = ""
  browser.stdio[4].on("data", data => {
    const messages = (rest + data).split("\0")
    rest = messages.pop()
    for (const message of messages.map(text => JSON.parse(text))) {
      const { id, error, result } = message
      if (!id) onEvent(message)
      else if (error) waiting.get(id)?.reject(new Error(error.message))
      else waiting.get(id)?.resolve(result)
      waiting.delete(id)
    }
  }).on("error", () => {})
  browser.stdio[3].on("error", () => {})
  const fail = words => {
    for (const { reject } of waiting.values()) reject(new Error(words))
    waiting.clear()
  }
  ended.then(code => fail(`Chromium ended with ${code}`))
  const alarm = setTimeout(() => fail(`no answer in ${patience / 1000} s`), patience)

  const send = (method, params = {}, sessionId) => new Promise((resolve, reject) => {
    const id = ++count
    waiting.set(id, { resolve, reject })
    browser.stdio[3].write(`${JSON.stringify({ id, method, params, sessionId })}\0`)
  })

  // Opens a page in a profile of its own, without cache and workers of other pages. Returns functions for it.
  async function page(url, prepare = async () => {}) {
    const { browserContextId } = await send("Target.createBrowserContext")
    const { targetId } = await send("Target.createTarget", { url: "about:blank", browserContextId, width: 1000, height: 800 })
    const { sessionId } = await send("Target.attachToTarget", { targetId, flatten: true })
    const ask = (method, params) => send(method, params, sessionId)
    await prepare(ask, sessionId)
    await ask("Page.enable")
    await ask("Page.navigate", { url })
    return {
      ask,
      // Evaluates an expression, which may be a promise.
      async evaluate(expression) {
        const { result, exceptionDetails } = await ask("Runtime.evaluate", { expression, awaitPromise: true, returnByValue: true })
        if (exceptionDetails) throw new Error(exceptionDetails.exception?.description ?? exceptionDetails.text)
        return result.value
      },
      // Returns a screenshot as PNG in base64.
      screenshot: async () => (await ask("Page.captureScreenshot", { format: "png" })).data,
      close: () => send("Target.disposeBrowserContext", { browserContextId }),
    }
  }

  async function close() {
    clearTimeout(alarm)
    await end(browser, ended)
    rmSync(home, { recursive: true, force: true, maxRetries: 20, retryDelay: 250 })
  }
  return { send, page, close }
}
