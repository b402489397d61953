// The viewer: shows a file, given by drop, dialogue or ?file=URL, at any zoom. Whatever is seen is decoded at the screen's pixels.
import { Decoder } from "../ssplat.js"

const get = id => document.getElementById(id)
// What a page of one file holds in itself (pack-viewer.mjs).
const held = id => get(id) && Uint8Array.from(atob(get(id).textContent), c => c.charCodeAt(0))
const stage = get("stage"), picture = get("picture"), overlay = get("overlay")
const decoder = get("held-module") ? new Decoder({ module: held("held-module") }) : new Decoder({ worker: true })
const say = words => get("status").textContent = words
const number = v => v.toLocaleString("en")
// More ellipses than these are no longer seen apart.
const mostEllipses = 20000

let file, info, all
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
    const read = await decoder.info(bytes)
    ;[file, info, all, drawn] = [bytes, read, undefined, undefined]
    all = await decoder.gaussians(bytes)
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

// Puts what there is where it belongs, and has the rest decoded.
function show() {
  if (!info) return
  const scale = devicePixelRatio, context = picture.getContext("2d")
  for (const canvas of [picture, overlay]) {
    const [w, h] = [Math.round(stage.clientWidth * scale), Math.round(stage.clientHeight * scale)]
    if (canvas.width != w || canvas.height != h) [canvas.width, canvas.height] = [w, h]
  }
  context.setTransform(1, 0, 0, 1, 0, 0)
  context.clearRect(0, 0, picture.width, picture.height)
  if (drawn) {
    const [x, y, w, h] = drawn.region, place = (v, start) => Math.round((start + v * zoom) * scale)
    context.drawImage(drawn.canvas, place(x, left), place(y, top_), place(x + w, left) - place(x, left), place(y + h, top_) - place(y, top_))
  }
  ellipses()
  say(`${info.width} × ${info.height}, ${number(info.primitives)} Gaussians in ${number(info.bytes)} bytes, shown at ${(100 * zoom).toPrecision(3)} %`)
  redraw()
}

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
  const context = overlay.getContext("2d"), scale = devicePixelRatio
  context.setTransform(1, 0, 0, 1, 0, 0)
  context.clearRect(0, 0, overlay.width, overlay.height)
  if (!get("ellipses").checked || !all) return
  context.lineWidth = scale
  let count = 0
  for (let i = 0; i < all.count && count < mostEllipses; i++) {
    const x = (left + all.mean[2 * i] * zoom) * scale, y = (top_ + all.mean[2 * i + 1] * zoom) * scale
    const [major, minor] = [all.scale[2 * i] * zoom * scale, all.scale[2 * i + 1] * zoom * scale]
    if (x + major < 0 || y + major < 0 || x - major > overlay.width || y - major > overlay.height) continue
    const [r, g, b] = [0, all.channels > 2 ? 1 : 0, all.channels > 2 ? 2 : 0].map(k => Math.round(255 * Math.min(Math.max(all.color[4 * i + k], 0), 1)))
    // In its own colour, between two that keep it apart from the picture.
    context.beginPath()
    context.ellipse(x, y, Math.max(major, .5), Math.max(minor, .5), all.rotation[i], 0, 2 * Math.PI)
    context.strokeStyle = r + g + b > 380 ? "#000a" : "#fffa"
    context.lineWidth = 2.5 * scale
    context.stroke()
    context.strokeStyle = `rgb(${r} ${g} ${b})`
    context.lineWidth = scale
    context.stroke()
    count++
  }
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
  ellipses()
}
const keys = { ArrowLeft: () => move(64, 0), ArrowRight: () => move(-64, 0), ArrowUp: () => move(0, 64), ArrowDown: () => move(0, -64), "+": () => zoomBy(1.25), "=": () => zoomBy(1.25), "-": () => zoomBy(.8), 0: fit, 1: actual, g: toggle }
stage.addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey || !keys[event.key]) return
  event.preventDefault()
  keys[event.key]()
})
get("fit").onclick = fit
get("actual").onclick = actual
get("in").onclick = () => zoomBy(1.5)
get("out").onclick = () => zoomBy(1 / 1.5)
get("ellipses").onchange = ellipses
get("facts").onchange = event => get("panel").hidden = !event.target.checked
get("file").onchange = async event => {
  const [chosen] = event.target.files
  if (chosen) open(await chosen.arrayBuffer(), chosen.name)
}
addEventListener("dragover", event => {
  event.preventDefault()
  stage.classList.add("drop")
})
addEventListener("dragleave", () => stage.classList.remove("drop"))
addEventListener("drop", async event => {
  event.preventDefault()
  stage.classList.remove("drop")
  const [dropped] = event.dataTransfer.files
  if (dropped) open(await dropped.arrayBuffer(), dropped.name)
})
let size = ""
new ResizeObserver(() => {
  const now = `${stage.clientWidth} ${stage.clientHeight}`
  if (now != size) show()
  size = now
}).observe(stage)

if (get("held-file")) open(held("held-file"), get("held-file").dataset.name)
const asked = new URLSearchParams(location.search).get("file")
if (asked) {
  const response = await fetch(asked).catch(error => ({ statusText: error.message }))
  if (response.ok) open(await response.arrayBuffer(), asked.split("/").pop())
  else say(`${asked}: ${response.statusText || response.status}`)
}
