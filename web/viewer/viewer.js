// The viewer: shows a file, given by drop, dialogue or ?file=URL, at any zoom, beside its original (?original=URL).
// What is seen is drawn at the screen's pixels: by WebGPU or WebGL2 where they can, else by the decoder. With ?draw=webgpu, webgl or
// decoder it is that one, or the decoder.
import { Decoder, colorSpace } from "../ssplat.js"
import { Splatting } from "./splatting.js"
import { WebGpuSplatting } from "./webgpu.js"
import { ellipses as drawEllipses, errorsOf, tonesOfBits, tonesOfErrors } from "./gaussians.js"

const get = id => document.getElementById(id)
// What a page of one file holds in itself (`ssplat view --html`).
const held = id => get(id) && Uint8Array.from(atob(get(id).textContent), c => c.charCodeAt(0))
const stage = get("stage"), picture = get("picture"), overlay = get("overlay")
const asked = new URLSearchParams(location.search)
const decoder = get("held-module") ? new Decoder({ module: held("held-module") }) : new Decoder({ worker: true })
const say = words => get("status").textContent = words
const number = v => v.toLocaleString("en")
let file, info, all, original
// What colours the Gaussians, for each choice that there is.
let tones = {}
// Draws on the graphics device; nothing where there is none that can, and until one is found.
let device
// CSS pixels a pixel of the picture, and where the picture's corner is on the stage.
let zoom = 1, left = 0, top_ = 0
// What was decoded last: a canvas and the part of the picture that it shows.
let drawn
let busy = false, stale = false

function table(caption, rows) {
  const element = document.createElement("table")
  element.createCaption().textContent = caption
  for (const row of rows) {
    const line = element.insertRow()
    for (const cell of row) line.insertCell().textContent = cell
  }
  return element
}

function describe() {
  const kinds = ["", "grey", "grey and alpha", "colour", "colour and alpha"], each = bits => info.primitives ? (bits / info.primitives).toFixed(2) : "–"
  get("panel").replaceChildren(
    table("Picture", [["size", `${info.width} × ${info.height}`], ["channels", kinds[info.channels]], ["depth", `${info.depth} bits`], ["orientation", info.orientation], ["ICC profile", `${info.icc.length} bytes`], ["EXIF", `${info.exif.length} bytes`]]),
    table("File", [["bytes", number(info.bytes)], ["layout", info.layout], ["blend", info.blend], ["Gaussians", number(info.primitives)], ["levels", Math.max(1, info.levels.length)], ["groups", info.groups], ["codebook", info.codebook || "none"]]),
    table("Parts, bytes", info.parts.map(p => [p.name, number(p.bytes)])),
    ...info.sections.length ? [table("Sections, bytes", info.sections.map(s => [s.name, number(s.bytes)]))] : [],
    table("Bits a Gaussian", info.fields.map(f => [f.name, each(f.bits)])),
  )
}

async function open(bytes, name) {
  say(`Reading ${name}`)
  try {
    const read = await decoder.info(bytes), gaussians = await decoder.gaussians(bytes)
    ;[file, info, all, drawn] = [bytes, read, gaussians, undefined]
    tones = info.each.length ? { bits: tonesOfBits(info.each) } : {}
    get("colours").value = "own"
    compareWith(undefined)
    device?.load(all, info.blend, colorSpace(info.icc))
    get("name").textContent = document.title = name
    get("hint").hidden = true
    describe()
    fit()
  } catch (error) {
    say(`${name}: ${error.message}`)
    console.error(error)
  }
}

function fit() {
  if (!info) return
  const { clientWidth: w, clientHeight: h } = stage
  zoom = Math.min(w / info.width, h / info.height)
  ;[left, top_] = [(w - info.width * zoom) / 2, (h - info.height * zoom) / 2]
  show()
}

// Zooms by `factor` and keeps the point (x, y) of the stage where it is.
function zoomBy(factor, x = stage.clientWidth / 2, y = stage.clientHeight / 2) {
  if (!info) return
  const next = Math.min(Math.max(zoom * factor, 1 / 256), 4096), k = next / zoom
  ;[zoom, left, top_] = [next, x - (x - left) * k, y - (y - top_) * k]
  show()
}

function move(dx, dy) {
  left += dx
  top_ += dy
  show()
}

// What the Gaussians can be coloured by.
function offer() {
  for (const choice of get("colours").options) choice.disabled = choice.value != "own" && !tones[choice.value]
  if (get("colours").selectedOptions[0].disabled) get("colours").value = "own"
}

// Takes a picture to compare with, or none.
async function compareWith(picture) {
  original = picture
  delete tones.error
  offer()
  get("comparing").hidden = !picture
  if (!picture) return
  show()
  // Errors are seen as well in a picture of this width.
  const from = file, width = Math.min(info.width, 1024), decoded = await decoder.decode(file, { width }).catch(error => say(error.message))
  if (!decoded || from != file || original != picture) return
  const canvas = new OffscreenCanvas(decoded.width, decoded.height), context = canvas.getContext("2d", { colorSpace: decoded.colorSpace })
  context.imageSmoothingQuality = "high"
  context.drawImage(picture, 0, 0, canvas.width, canvas.height)
  tones.error = tonesOfErrors(errorsOf(all, decoded, context.getImageData(0, 0, canvas.width, canvas.height, { colorSpace: decoded.colorSpace })))
  offer()
  ellipses()
}

// A file that was dropped, chosen or asked for: a .ssplat file is shown, another picture is its original.
async function take(bytes, name) {
  const start = new Uint8Array(bytes, 0, Math.min(4, bytes.byteLength)), ours = [0x89, 0x53, 0x53, 0x50].every((v, i) => start[i] == v)
  if (ours || !info) return open(bytes, name)
  try {
    await compareWith(await createImageBitmap(new Blob([bytes])))
  } catch (error) {
    say(`${name}: neither a .ssplat file nor a picture that this browser knows`)
    console.error(error)
  }
}

// Where the picture is in the canvas: pixels of the canvas a pixel of the picture, and its corner.
const place = () => [zoom, left, top_].map(v => v * devicePixelRatio)

// Says what is seen, and has it drawn with the screen's next picture.
let waiting = false
function show() {
  if (!info) return
  say(`${info.width} × ${info.height}, ${number(info.primitives)} Gaussians in ${number(info.bytes)} bytes, shown at ${(100 * zoom).toPrecision(3)} %${legend()}`)
  if (!waiting) requestAnimationFrame(paint)
  waiting = true
}

function paint() {
  waiting = false
  for (const canvas of [picture, overlay]) {
    const [w, h] = [stage.clientWidth, stage.clientHeight].map(v => Math.round(v * devicePixelRatio))
    if (canvas.width != w || canvas.height != h) [canvas.width, canvas.height] = [w, h]
  }
  const context = picture.getContext("2d"), [k, x, y] = place(), { width, height } = picture
  context.clearRect(0, 0, width, height)
  const view = { left: -x / k, top: -y / k, step: 1 / k, width, height }
  const byDevice = device?.can(view) ?? false
  stage.dataset.drawn = byDevice ? device.name : "decoder"
  if (byDevice) {
    device.draw(view)
    context.drawImage(device.canvas, 0, 0)
  } else if (drawn) {
    const [left, top, w, h] = drawn.region, [x0, y0, x1, y1] = [x + left * k, y + top * k, x + (left + w) * k, y + (top + h) * k].map(Math.round)
    context.drawImage(drawn.canvas, x0, y0, x1 - x0, y1 - y0)
  }
  if (original) {
    const border = Math.round(width * get("split").value / 100)
    context.save()
    context.beginPath()
    context.rect(border, 0, width - border, height)
    context.clip()
    // Its pixels are seen where they are enlarged.
    context.imageSmoothingEnabled = k * info.width < original.width
    context.clearRect(0, 0, width, height)
    context.drawImage(original, x, y, info.width * k, info.height * k)
    context.restore()
    context.fillStyle = "#fff"
    context.fillRect(border - 1, 0, 2, height)
    context.fillStyle = "#000"
    context.fillRect(border + 1, 0, 1, height)
  }
  ellipses()
  if (byDevice) stage.dispatchEvent(new Event("drawn"))
  else redraw()
}

const legends = { bits: "; blue Gaussians take few bits, red ones many", error: "; the error is small at blue Gaussians, large at red ones" }
const legend = () => get("ellipses").checked && legends[get("colours").value] || ""

// The part that is seen, in whole pixels of the picture: left, top, width, height.
function visible() {
  const ends = (start, side, length) => [Math.max(0, Math.floor(-start / zoom)), Math.min(length, Math.ceil((side - start) / zoom))]
  const [x0, x1] = ends(left, stage.clientWidth, info.width), [y0, y1] = ends(top_, stage.clientHeight, info.height)
  return x1 > x0 && y1 > y0 ? [x0, y0, x1 - x0, y1 - y0] : undefined
}

// One decoding at a time; when it is done, the next of what is seen by then.
async function redraw() {
  if (busy) return stale = true
  const region = visible(), from = file, scale = zoom * devicePixelRatio
  if (!region) return
  // At a high zoom a pixel of the picture is wider than the stage: its samples are bounded, the browser enlarges the rest.
  const width = Math.max(1, Math.min(Math.round(region[2] * scale), 4096)), height = Math.max(1, Math.min(Math.round(region[3] * scale), 4096))
  const key = [...region, width, height].join()
  if (drawn?.key == key) return
  busy = true
  try {
    const image = await decoder.decode(from, { region, width, height }), canvas = new OffscreenCanvas(width, height)
    canvas.getContext("2d", { colorSpace: image.colorSpace }).putImageData(image, 0, 0)
    if (from == file) drawn = { canvas, region, key }
  } catch (error) {
    say(error.message)
    console.error(error)
    return
  } finally {
    busy = false
  }
  show()
  stage.dispatchEvent(new Event("drawn"))
  if (stale) {
    stale = false
    redraw()
  }
}

function ellipses() {
  const context = overlay.getContext("2d")
  context.clearRect(0, 0, overlay.width, overlay.height)
  if (get("ellipses").checked && all) drawEllipses(context, all, place(), devicePixelRatio, tones[get("colours").value])
}

const pointers = new Map
stage.addEventListener("pointerdown", event => {
  stage.setPointerCapture(event.pointerId)
  pointers.set(event.pointerId, [event.offsetX, event.offsetY])
})
stage.addEventListener("pointermove", event => {
  const before = pointers.get(event.pointerId)
  if (!before) return
  const now = [event.offsetX, event.offsetY], [other] = [...pointers].filter(([id]) => id != event.pointerId).map(([, at]) => at)
  pointers.set(event.pointerId, now)
  if (!other) return move(now[0] - before[0], now[1] - before[1])
  // Two fingers: their distance zooms about their middle, which moves.
  const distance = at => Math.hypot(at[0] - other[0], at[1] - other[1])
  move((now[0] - before[0]) / 2, (now[1] - before[1]) / 2)
  if (distance(before) > 1) zoomBy(distance(now) / distance(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2)
})
for (const name of ["pointerup", "pointercancel"]) stage.addEventListener(name, event => pointers.delete(event.pointerId))
stage.addEventListener("wheel", event => {
  event.preventDefault()
  zoomBy(2 ** (-event.deltaY / (event.deltaMode ? 8 : 240)), event.offsetX, event.offsetY)
}, { passive: false })

const actual = () => zoomBy(1 / zoom / devicePixelRatio)
function toggle() {
  get("ellipses").checked = !get("ellipses").checked
  mark()
}
function mark() {
  ellipses()
  show()
}
// The next of the colours that there are.
function recolour() {
  const choices = [...get("colours").options].filter(choice => !choice.disabled), at = choices.findIndex(choice => choice.selected)
  get("colours").value = choices[(at + 1) % choices.length].value
  mark()
}
function split(by) {
  get("split").value = Number(get("split").value) + by
  show()
}
const keys = { ArrowLeft: () => move(64, 0), ArrowRight: () => move(-64, 0), ArrowUp: () => move(0, 64), ArrowDown: () => move(0, -64), "+": () => zoomBy(1.25), "=": () => zoomBy(1.25), "-": () => zoomBy(.8), 0: fit, 1: actual, g: toggle, c: recolour, "[": () => split(-5), "]": () => split(5) }
stage.addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey || !keys[event.key]) return
  event.preventDefault()
  keys[event.key]()
})
get("fit").onclick = fit
get("actual").onclick = actual
get("in").onclick = () => zoomBy(1.5)
get("out").onclick = () => zoomBy(1 / 1.5)
get("ellipses").onchange = get("colours").onchange = mark
get("split").oninput = show
get("facts").onchange = event => get("panel").hidden = !event.target.checked
for (const id of ["file", "original"]) get(id).onchange = async event => {
  const [chosen] = event.target.files
  if (chosen) take(await chosen.arrayBuffer(), chosen.name)
}
addEventListener("dragover", event => {
  event.preventDefault()
  stage.classList.add("drop")
})
addEventListener("dragleave", () => stage.classList.remove("drop"))
addEventListener("drop", async event => {
  event.preventDefault()
  stage.classList.remove("drop")
  const files = await Promise.all([...event.dataTransfer.files].map(async f => [await f.arrayBuffer(), f.name]))
  // Of two at once, the .ssplat file comes first.
  files.sort(([, a], [, b]) => b.endsWith(".ssplat") - a.endsWith(".ssplat"))
  for (const [bytes, name] of files.slice(0, 2)) await take(bytes, name)
})
let size = ""
new ResizeObserver(() => {
  const now = `${stage.clientWidth} ${stage.clientHeight}`
  if (now != size) show()
  size = now
}).observe(stage)

async function fetched(url) {
  const response = await fetch(url).catch(error => ({ statusText: error.message }))
  if (response.ok) return take(await response.arrayBuffer(), url.split("/").pop())
  say(`${url}: ${response.statusText || response.status}`)
}
const draw = asked.get("draw"), takes = name => !draw || draw == name
// Takes a device, for the file that may be there already.
function use(next) {
  device = next || takes("webgl") && Splatting.create() || undefined
  if (next) next.onlost = () => use()
  if (all) device?.load(all, info.blend, colorSpace(info.icc))
  show()
}
use(takes("webgpu") && await WebGpuSplatting.create(draw == "webgpu"))
for (const id of ["file", "original"]) {
  const inside = held(`held-${id}`)
  if (inside) await take(inside.buffer, get(`held-${id}`).dataset.name)
  else if (asked.get(id)) await fetched(asked.get(id))
}
