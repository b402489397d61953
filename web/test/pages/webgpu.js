// Tests the viewer's rendering with WebGPU: it equals that with WebGL2, and a page uses it on request.
import { WebGpuSplatting } from "/web/dist/viewer/webgpu.js"
import { within } from "./splatting.js"

const patience = 60_000

export async function test(cases) {
  const adapters = globalThis.GPUAdapter?.prototype, request = adapters?.requestDevice
  let taken
  if (adapters) adapters.requestDevice = async function (...wishes) { return taken = await request.apply(this, wishes) }
  const device = await WebGpuSplatting.create(true)
  // The adapters of a browser depend on the system.
  if (!device) return { problems: [], words: "skipped, no adapter of WebGPU adds 32-bit floats up" }
  let gone
  taken.lost.then(({ message }) => gone = message)
  const { problems, words } = await within(cases, device).catch(error => ({ problems: [String(error.stack)], words: "stopped" }))
  // A crash of the browser's graphics process is not a failure of this test, but a validation error is.
  if (gone) return { problems: [], words: `skipped, the browser took the device away: ${gone}` }
  if (device.lost) return { problems: [...problems, "the device reported an error"], words }
  // The loss of a device is reported, and the device is no longer used.
  const told = new Promise(resolve => device.onlost = resolve), view = { left: 0, top: 0, step: 1, width: 8, height: 8 }
  if (!device.can(view)) problems.push("a small view is not claimed")
  taken.destroy()
  await told
  if (device.can(view)) problems.push("a device that is lost claims a view")
  // It is also visible on the page, and equals the rendering of WebGL2.
  const page = async (draw, name) => {
    const frame = document.createElement("iframe")
    frame.src = `/web/dist/viewer/index.html?file=/spec/vectors/valid/coded-rgb/file.ssplat&draw=${draw}`
    frame.style = "width: 900px; height: 600px; border: 0"
    document.body.replaceChildren(frame)
    await new Promise(resolve => frame.onload = resolve)
    const get = id => frame.contentDocument.getElementById(id), pixels = () => get("picture").getContext("2d").getImageData(0, 0, get("picture").width, get("picture").height).data
    for (let i = 0; i < patience / 50; i++) {
      if (get("stage").dataset.drawn == name && pixels().some(v => v > 0 && v < 255)) return pixels()
      await new Promise(r => setTimeout(r, 50))
    }
    problems.push(`${draw} is drawn by ${get("stage").dataset.drawn}: ${get("status").textContent}`)
    return []
  }
  const [seen, expected] = [await page("webgpu", "WebGPU"), await page("webgl", "WebGL2")]
  if (seen.length != expected.length || !seen.every((v, i) => Math.abs(v - expected[i]) <= 2)) problems.push("the page is not as by WebGL2")
  return { problems, words }
}
