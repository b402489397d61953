// Headless Firefox under Marionette, the protocol of its own tests: JSON with lengths over TCP.
import { spawn } from "node:child_process"
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs"
import { connect } from "node:net"
import { tmpdir } from "node:os"
import { join } from "node:path"
import { end } from "./browser.mjs"

// Starts Firefox in a profile of its own; returns undefined if it is not installed. After `patience` milliseconds all requests fail.
export async function firefox(patience = 300_000) {
  const home = mkdtempSync(join(tmpdir(), "ssplat-marionette-"))
  // Firefox chooses a free port and writes it to its profile.
  writeFileSync(join(home, "user.js"), `user_pref("marionette.port", 0)\n`)
  const options = ["--headless", "--no-remote", "--marionette", "--profile", home, "--width", "1000", "--height", "800", "about:blank"]
  const browser = spawn(process.env.FIREFOX ?? "firefox", options, { stdio: "ignore", detached: true, env: { ...process.env, HOME: home } })
  const started = await new Promise(resolve => browser.on("spawn", () => resolve(true)).on("error", () => resolve(false)))
  if (!started) return rmSync(home, { recursive: true, force: true })
  const ended = new Promise(resolve => browser.on("exit", resolve)), waiting = new Map
  let failed
  const fail = words => {
    failed ??= new Error(words)
    for (const { reject } of waiting.values()) reject(failed)
    waiting.clear()
  }
  ended.then(code => fail(`Firefox ended with ${code}`))
  const alarm = setTimeout(() => fail(`no answer in ${patience / 1000} s`), patience)
  const close = async () => {
    clearTimeout(alarm)
    await end(browser, ended)
    rmSync(home, { recursive: true, force: true, maxRetries: 20, retryDelay: 250 })
  }
  try {
    let port
    while (!port) {
      if (failed) throw failed
      try {
        port = Number(readFileSync(join(home, "MarionetteActivePort"), "utf8"))
      } catch {
        await new Promise(resolve => setTimeout(resolve, 100))
      }
    }
    const socket = connect(port, "127.0.0.1").on("error", error => fail(`Marionette: ${error.message}`))
    let data = Buffer.alloc(0), count = 0
    socket.on("data", more => {
      data = Buffer.concat([data, more])
      for (;;) {
        const colon = data.indexOf(58), end = colon + 1 + Number(data.subarray(0, Math.max(colon, 0)))
        if (colon < 0 || data.length < end) break
        const message = JSON.parse(data.subarray(colon + 1, end))
        data = data.subarray(end)
        // The first message is a greeting.
        if (!Array.isArray(message)) continue
        const [, id, error, result] = message
        if (error) waiting.get(id)?.reject(new Error(`${error.error}: ${error.message}`))
        else waiting.get(id)?.resolve(result)
        waiting.delete(id)
      }
    })
    const send = (name, params = {}) => new Promise((resolve, reject) => {
      if (failed) return reject(failed)
      waiting.set(++count, { resolve, reject })
      const message = JSON.stringify([0, count, name, params])
      socket.write(`${Buffer.byteLength(message)}:${message}`)
    })
    const { capabilities } = await send("WebDriver:NewSession", { strictFileInteractability: true })
    await send("WebDriver:SetTimeouts", { script: patience })
    return {
      version: capabilities.browserVersion,
      navigate: url => send("WebDriver:Navigate", { url }),
      reload: () => send("WebDriver:Refresh"),
      // Evaluates an expression, which may be a promise.
      async evaluate(expression) {
        const script = `const done = arguments[arguments.length - 1]
          Promise.resolve().then(() => eval(${JSON.stringify(expression)})).then(value => done({ value }), error => done({ error: String(error) }))`
        const { value: { value, error } } = await send("WebDriver:ExecuteAsyncScript", { script, args: [], sandbox: null })
        if (error) throw new Error(error)
        return value
      },
      // Returns a screenshot as PNG in base64.
      screenshot: async () => (await send("WebDriver:TakeScreenshot", { full: false, hash: false })).value,
      close,
    }
  } catch (error) {
    await close()
    throw error
  }
}
