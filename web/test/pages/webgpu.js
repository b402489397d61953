// What the viewer's drawing by WebGPU promises: the same as by WebGL2, and that a page takes it when it is asked for.
import { WebGpuSplatting } from "/web/dist/viewer/webgpu.js"
import { within } from "./splatting.js"

const patience = 60_000

export async function test(cases) {
  const adapters = globalThis.GPUAdapter?.prototype, request = adapters?.requestDevice
  let taken
  if (adapters) adapters.requestDevice = async function (...wishes) { return taken = await request.apply(this, wishes) }
  const device = await WebGpuSplatting.create(true)
  // Which adapters a browser has is the system's choice.
  if (!device) return { problems: [], words: "skipped, no adapter of WebGPU adds 32-bit floats up" }
  let gone
  taken.lost.then(({ message }) => gone = message)
  const { problems, words } = await within(cases, device).catch(error => ({ problems: [String(error.stack)], words: "stopped" }))
  // Whether a browser's process for graphics bears up is its own affair; what it finds wrong here is an error and no loss.
  if (gone) return { problems: [], words: `skipped, the browser took the device away: ${gone}` }
  if (device.lost) return { problems: [...problems, "the device reported an error"], words }
  // One that is taken away is told, and claims nothing any more.
  const told = new Promise(resolve => device.onlost = resolve), view = { left: 0, top: 0, step: 1, width: 8, height: 8 }
  if (!device.can(view)) problems.push("a small view is not claimed")
  taken.destroy()
  await told
  if (device.can(view)) problems.push("a device that is lost claims a view")
  // On the page it is seen, too, and is what WebGL2 draws there.
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
