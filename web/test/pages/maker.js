// Tests the page that encodes: a dropped picture is encoded to a file that can be saved, without a request; accessibility; and invalid
// input.
import { encode } from "/web/dist/encode.js"
import { generated } from "/web/test/generated.js"
import { decode } from "/web/dist/ssplat.js"
import { size } from "/web/dist/viewer/facts.js"

const patience = 60_000
const until = async what => {
  for (let i = 0; i < patience / 50; i++) {
    const v = await what()
    if (v) return v
    await new Promise(r => setTimeout(r, 50))
  }
}
const asked = async () => (await fetch("/asked")).json()

async function open(width = 1440, height = 900) {
  const frame = document.createElement("iframe")
  frame.src = "/web/dist/viewer/index.html"
  frame.style = `width: ${width}px; height: ${height}px; border: 0`
  document.body.replaceChildren(frame)
  await new Promise(resolve => frame.onload = resolve)
  const page = frame.contentWindow, get = id => page.document.getElementById(id)
  if (!await until(() => page.document.querySelectorAll(".sample").length == 3)) throw new Error("the page has no samples")
  // The encoder is fetched in advance.
  if (!await until(() => page.performance.getEntriesByType("resource").some(e => /ssplat-encode-\w+\.wasm$/.test(e.name)))) throw new Error("the encoder is not fetched")
  const script = Object.assign(page.document.createElement("script"), { type: "module", textContent: "import { load } from './encoder.js'; await load(); window.isReady = true" })
  page.document.body.append(script)
  if (!await until(() => page.isReady)) throw new Error("the encoder is not there")
  return { page, get }
}

// Converts interleaved samples to RGBA.
function imageOf({ width, height, channels, data }) {
  const image = new ImageData(width, height)
  for (let i = 0; i < width * height; i++)
    for (let k = 0; k < 4; k++) image.data[4 * i + k] = k < channels ? data[channels * i + k] : 255
  return image
}
async function png(pixels) {
  const canvas = new OffscreenCanvas(pixels.width, pixels.height)
  canvas.getContext("2d").putImageData(imageOf(pixels), 0, 0)
  return canvas.convertToBlob()
}

function give({ page }, type, name, ...parts) {
  const data = new page.DataTransfer()
  data.items.add(new page.File(parts, name))
  if (type == "paste") page.dispatchEvent(new page.ClipboardEvent("paste", { clipboardData: data }))
  else page.dispatchEvent(new page.DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true }))
}
const move = ({ page, get }, id, value) => {
  get(id).value = value
  get(id).dispatchEvent(new page.Event("input", { bubbles: true }))
}
const busy = ({ get }) => !get("progress").hidden
const done = shown => until(() => !busy(shown) && /\d/.test(shown.get("score").textContent) && !shown.get("save").hidden)
const saved = async ({ page, get }) => new Uint8Array(await (await page.fetch(get("save").href)).arrayBuffer())
const same = (a, b) => a.length == b.length && a.every((v, i) => v == b[i])

async function flow(check) {
  const shown = await open(), { page, get } = shown, pixels = generated(160, 120, 3, 8), blob = await png(pixels)
  check(/never leaves this device/.test(get("empty").textContent), "the page does not say that pictures stay")
  const raw = 160 * 120 * 3, { bytes: expected } = await encode(pixels, { bytes: Math.floor(raw / 50), effort: 5 })
  const image = await decode(expected)
  check(image.width == 160 && image.height == 120, "what is expected is no picture of that size")
  await asked()
  give(shown, "drop", "A photo.png", blob)
  check(await until(() => busy(shown)), "no progress is shown")
  check(await until(() => get("name").textContent == "A photo.png" || !busy(shown)), "the picture is not shown while it is encoded")
  check(await done(shown), `there is no result: ${get("trouble").textContent}`)
  const first = await saved(shown)
  check(same(first, expected), `${first.length} bytes are saved, not the ${expected.length} of encode()`)
  check(get("save").download == "A photo.ssplat" && get("bytes").textContent == size(first.length), `${get("save").download}, ${get("bytes").textContent}`)
  const score = Number(get("score").textContent)
  check(score > -100 && score < 100 && !get("border").hidden && /original/.test(get("border").textContent), `${score} is told of two sides`)

  // The sliders: the old result is shown until the new one is ready, and the view does not move.
  page.document.body.dispatchEvent(new page.KeyboardEvent("keydown", { key: "1", bubbles: true, cancelable: true }))
  const zoom = get("zoom").textContent, href = get("save").href
  for (let i = 1; i <= 20; i++) move(shown, "amount", 2 * i)
  check(!busy(shown) && get("save").href == href, "an encode starts while the slider moves")
  check(await until(() => busy(shown)) && get("save").href == href && !get("save").hidden, "the old result goes before the new one is there")
  check(await until(() => get("save").href != href) && await done(shown), "the slider changes nothing")
  const second = await saved(shown)
  check(second.length > 3 * first.length && get("zoom").textContent == zoom, `a larger file has ${second.length} bytes, at ${get("zoom").textContent}`)

  // A requested quality is reached.
  page.document.querySelector("input[name=target][value=quality]").click()
  move(shown, "effort", 1)
  move(shown, "quality", 40)
  check(await until(() => get("save").href != href && Number(get("score").textContent) >= 40 && !busy(shown)), `a quality of 40 is ${get("score").textContent}`)

  // After cancelling, the last result remains, and can be requested again.
  const before = get("save").href
  move(shown, "effort", 9)
  await until(() => busy(shown))
  get("cancel").click()
  check(!busy(shown) && get("save").href == before && !get("again").hidden, "Cancel does not stop it")
  move(shown, "effort", 1)

  // A pasted picture replaces it.
  give(shown, "paste", "other.png", await png(generated(40, 30, 4, 8)))
  check(await until(() => get("name").textContent == "other.ssplat") && await done(shown), "a pasted picture is not encoded")
  const sent = await asked()
  check(sent.length == 0, `the page sends requests: ${sent.join(", ")}`)
}

// Files that are not pictures, or too large, cause a message, and the page continues to work.
async function hostile(check) {
  const shown = await open(), { get } = shown, good = await png(generated(64, 48, 3, 8)), bytes = new Uint8Array(await good.arrayBuffer())
  const bomb = bytes.slice()
  new DataView(bomb.buffer).setUint32(16, 60_000)
  new DataView(bomb.buffer).setUint32(20, 60_000)
  const crcAt = 12 + 4 + 13, { crc32 } = await import("/web/test/files.js")
  new DataView(bomb.buffer).setUint32(crcAt, crc32(bomb.subarray(12, crcAt)))
  const cases = [
    ["bomb.png", [bomb], /bomb\.png cannot be read.*PNG picture.*(3600 megapixels|too large)/s],
    ["cut.png", [bytes.subarray(0, 60)], /cut\.png cannot be read.*PNG picture.*broken/s],
    ["noise.jpg", [Uint8Array.of(0xff, 0xd8, 0xff), new Uint8Array(5000).fill(7)], /noise\.jpg cannot be read.*JPEG/s],
    ["notes.png", ["only text"], /neither a picture nor an \.ssplat file/],
    ["drawing.svg", ['<svg xmlns="http://www.w3.org/2000/svg" width="9e9" height="9e9"/>'], /neither.*SVG drawing/s],
    ["empty.png", [], /neither.*an empty file/s],
  ]
  for (const [name, parts, words] of cases) {
    give(shown, "drop", name, ...parts)
    check(await until(() => !get("message").hidden && words.test(get("message").textContent)), `${name}: ${get("message").textContent}`)
    check(!busy(shown), `${name}: the page seems busy`)
    get("dismiss").click()
    check(!get("empty").hidden, `${name}: closing the message does not lead to the start`)
  }
  give(shown, "drop", "good.png", good)
  check(await done(shown), "after hostile pictures a good one is not encoded")
  // A target that cannot be met causes a message, and the last result remains.
  const { href } = get("save")
  move(shown, "amount", -80)
  check(await until(() => !get("trouble").hidden || get("save").href != href), "nothing is told")
  check(get("trouble").hidden || /does not fit/.test(get("trouble").textContent) && get("save").href == href, get("trouble").textContent)
}

// Checked with axe in both colour schemes, at desktop and phone sizes, with and without a picture.
async function accessible(check, axe) {
  for (const [width, height] of [[1440, 900], [390, 844]])
    for (const scheme of ["light", "dark"]) {
      const shown = await open(width, height), { page, get } = shown, place = `${width} × ${height}, ${scheme}`
      page.document.documentElement.style.colorScheme = scheme
      page.eval(axe)
      const violations = async state => {
        const { violations } = await page.axe.run()
        for (const { id, nodes } of violations) check(false, `${place}, ${state}: ${id} at ${nodes.map(n => n.target).join(", ")}: ${nodes[0].failureSummary}`)
        check(true)
      }
      await violations("empty")
      give(shown, "drop", "photo.png", await png(generated(160, 120, 3, 8)))
      await until(() => busy(shown))
      await violations("busy")
      await done(shown)
      await violations("done")
      for (const element of page.document.querySelectorAll("button, .pill, .choices label, a, input[type=range], #maker, #stage")) {
        if (!element.checkVisibility()) continue
        const { left, right, width: wide, height: high } = element.getBoundingClientRect()
        if (wide > 1) check(left >= 0 && right <= width + .5, `${place}: #${element.id} reaches from ${left} to ${right}`)
        if (wide > 1 && width < 640 && element.matches("button:not(#fold), a, .choices label, input[type=range]"))
          check(high >= 44, `${place}: #${element.id} is ${high} high, small for a finger`)
      }
      get("help-button").click()
      await violations("keys")
      get("help").close()
      get("facts").click()
      check(get("maker").hidden && !get("panel").hidden, `${place}: the facts do not take the place of the controls`)
      await violations("facts")
      get("settings").click()
      check(!get("maker").hidden && get("panel").hidden, `${place}: the controls do not come back`)
    }
}

export async function test(_, { axe }) {
  const problems = []
  let checks = 0
  const check = (good, words) => {
    checks++
    if (!good) problems.push(words)
  }
  await flow(check)
  await hostile(check)
  if (axe) await accessible(check, await (await fetch("/axe.js")).text())
  return { problems, words: `${checks} promises${axe ? "" : ", without axe"}` }
}
