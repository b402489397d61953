// The viewer: shows a file at any zoom, with its original (?original=URL). The file is dropped, pasted, chosen or given by ?file=URL.
// Pictures in other formats are encoded here and shown with the result. The visible part is rendered at the screen's resolution, with
// WebGPU or WebGL2 if they support it, otherwise with the decoder. ?draw=webgpu, webgl or decoder selects one of them, with the decoder as
// a fallback.
import { Decoder, colorSpace } from "../ssplat.js"
import { Camera, times } from "./camera.js"
import { facts, size, summary } from "./facts.js"
import { found, isOurs, isPicture } from "./found.js"
import { ellipses as drawEllipses, errorsOf, tonesOfBits, tonesOfErrors } from "./gaussians.js"
import { Mask } from "./mask.js"
import { Maker } from "./maker.js"
import { Splatting } from "./splatting.js"
import { WebGpuSplatting } from "./webgpu.js"

const get = id => document.getElementById(id)
// Data that is embedded in a page of one file (`ssplat view --html`).
const held = id => get(id) && Uint8Array.from(atob(get(id).textContent), c => c.charCodeAt(0))
const stage = get("stage"), picture = get("picture"), overlay = get("overlay")
const asked = new URLSearchParams(location.search)
const decoder = get("held-module") ? new Decoder({ module: held("held-module") }) : new Decoder({ worker: true })
const samples = [["parrots", "Parrots"], ["motocross", "Motocross"], ["portrait", "Portrait"]]
let file, info, all, original
// The picture on the stage: width, height, and whether it is transparent. It is the file, or the picture that is being encoded.
let shape
// The values that colour the Gaussians, for each choice.
let tones = {}
// The renderer on the graphics device; undefined if there is none, and until it is found.
let device
// Which part of the picture the exact layer covers; undefined without that layer.
let mask
// The last decoded view: a canvas and the part of the picture that it shows.
let drawn
let busy = false, stale = false
// Position of the border to the original, in percent of the stage.
let border = 50
const camera = new Camera(stage, () => show())

const chosen = name => document.querySelector(`input[name=${name}]:checked`).value
function choose(name, value) {
  document.querySelector(`input[name=${name}][value=${value}]`).checked = true
}
// Whether the file has layers besides the Gaussians.
const hasLayers = () => !!(info?.detail || info?.exact)
// How the layers are rendered; "off" if there are none.
const layer = () => hasLayers() ? chosen("layers") : "off"
const pressed = id => get(id).ariaPressed == "true"

// Shows a message in the middle of the page. `code` is shown in a monospaced font.
function tell(title, words, code = "") {
  const [first, second] = get("message").querySelectorAll("p")
  get("message").querySelector("h2").textContent = title
  first.textContent = words
  second.hidden = !code
  second.replaceChildren(Object.assign(document.createElement("code"), { textContent: code }))
  get("empty").hidden = true
  get("message").hidden = false
  get("another").focus()
}

function dismiss() {
  get("message").hidden = true
  if (!shape) welcome()
}

// Shows the start page, with three samples.
async function welcome() {
  get("empty").hidden = false
  if (get("samples").children.length > 1) return
  try {
    const cards = await Promise.all(samples.map(async ([name, title]) => {
      const response = await fetch(`samples/${name}.ssplat`)
      if (!response.ok) throw new Error(response.statusText)
      const bytes = new Uint8Array(await response.arrayBuffer()), card = Object.assign(document.createElement("button"), { className: "sample" })
      const canvas = document.createElement("canvas"), line = document.createElement("span"), image = await decoder.decode(bytes, { width: 420 })
      Object.assign(canvas, { width: image.width, height: image.height }).getContext("2d", { colorSpace: image.colorSpace }).putImageData(image, 0, 0)
      line.append(title, Object.assign(document.createElement("small"), { textContent: size(bytes.length) }))
      card.append(canvas, line)
      card.onclick = () => take(bytes, `${name}.ssplat`)
      return card
    }))
    if (get("samples").children.length > 1) return
    get("samples").append(...cards)
    get("samples").hidden = false
  } catch {
    // The samples are optional on a server.
  }
}

// Shows a picture of this size on the stage, and hides everything else.
function occupy(next, name) {
  shape = next
  get("name").textContent = document.title = name
  for (const id of ["empty", "message"]) get(id).hidden = true
  get("tools").hidden = false
  stage.classList.remove("vacant")
}

// Shows a file. A file that was encoded here from the picture `made` keeps the position of the previous one.
async function open(bytes, name, made, originalBytes) {
  get("wait").hidden = !!made
  try {
    const read = await decoder.info(bytes), gaussians = await decoder.gaussians(bytes)
    if (made && original != made) return
    if (!made) maker?.leave()
    ;[file, info, all] = [bytes, read, gaussians]
    tones = info.each.length ? { bits: tonesOfBits(info.each) } : {}
    mask = info.cells.length ? new Mask(info) : undefined
    device?.load(all, info.blend, colorSpace(info.icc, info.cicp))
    const { width, height, channels } = info
    occupy({ width, height, alpha: channels % 2 == 0 }, name)
    get("summary").textContent = summary(info)
    get("described").replaceChildren(...facts(info))
    for (const id of ["ellipses", "facts"]) get(id).disabled = false
    if (made) {
      label(` · ${size(bytes.length)}`, ` · ${size(originalBytes)}`)
      return void compareWith(made, chosen("sides"))
    }
    drawn = undefined
    label()
    settings()
    compareWith(undefined)
    camera.take(width, height)
    stage.focus()
  } catch (error) {
    const titles = { format: `${name} is broken`, version: `${name} has a version that is not supported`, limit: `${name} is too large` }
    tell(titles[error.kind] ?? `${name} cannot be shown`, `The decoder says: ${error.message}.`, error.kind == "format" ? `${size(bytes.length)}, beginning with ${found(bytes).start}` : "")
    console.error(error)
  } finally {
    get("wait").hidden = true
  }
}

// Handles a file that was dropped, chosen or requested. An .ssplat file is shown. Another picture is encoded, unless it was dropped onto a
// file or chosen as its original; then it is compared with the file.
async function take(buffer, name, isOriginal = !!info && !isMade()) {
  const bytes = new Uint8Array(buffer)
  if (isOurs(bytes)) return open(bytes, name)
  const { kind, start } = found(bytes)
  if (!isOriginal && maker && isPicture(bytes)) return maker.take(new Blob([bytes]), name, kind)
  if (isOriginal) {
    const image = await createImageBitmap(new Blob([bytes])).catch(() => undefined)
    if (image) return compareWith(image)
    return tell(`${name} cannot be compared with`, `It is ${kind ?? "of an unknown kind"}. The original is a picture that this browser can show.`, start && `It begins with ${start}`)
  }
  const advice = isPicture(bytes) ? ` The program makes one of it: ssplat encode ${name} ${name.replace(/\.[^.]*$/, "")}.ssplat` : ""
  tell(`${name} is neither a picture nor an .ssplat file`, `It is ${kind ?? "of an unknown kind"}.${advice}`, start && `It begins with ${start}; an .ssplat file with 89 53 53 50`)
}

// Updates the available colourings of the Gaussians and the controls.
function offer() {
  for (const choice of document.querySelectorAll("input[name=colours]")) choice.disabled = choice.value != "own" && !tones[choice.value]
  if (chosen("colours") != "own" && !tones[chosen("colours")]) choose("colours", "own")
  get("comparing").hidden = !original || !info
  get("compare").hidden = get("settings").hidden == false
  get("compare").ariaPressed = String(!!original)
  get("tones").hidden = !pressed("ellipses")
  get("layers").hidden = !hasLayers()
  get("mask").hidden = !mask
  const ends = { bits: ["few bits", "many"], error: ["small error", "large"] }[chosen("colours")]
  get("legend").hidden = !ends
  ;[get("least").textContent, get("most").textContent] = ends ?? ["", ""]
  show()
}

// Sets or removes the picture for comparison.
async function compareWith(picture, sides = "both") {
  original = picture
  delete tones.error
  choose("sides", sides)
  offer()
  if (!picture) return
  // A picture of this width is sufficient to show errors.
  const from = file, width = Math.min(info.width, 1024), decoded = await decoder.decode(file, { width }).catch(error => console.error(error))
  if (!decoded || from != file || original != picture) return
  const canvas = new OffscreenCanvas(decoded.width, decoded.height), context = canvas.getContext("2d", { colorSpace: decoded.colorSpace })
  context.imageSmoothingQuality = "high"
  context.drawImage(picture, 0, 0, canvas.width, canvas.height)
  tones.error = tonesOfErrors(errorsOf(all, decoded, context.getImageData(0, 0, canvas.width, canvas.height, { colorSpace: decoded.colorSpace })))
  offer()
}

// Returns the position of the picture in the canvas: canvas pixels per picture pixel, and its corner.
const place = () => [camera.zoom, camera.left, camera.top].map(v => v * devicePixelRatio)

// Schedules rendering for the next frame, and announces the view.
let waiting = false
function show() {
  if (!shape) return
  get("zoom").textContent = times(camera.zoom)
  const part = { file: "the file", both: "the file beside its original", original: "the original" }[!info ? "original" : original ? chosen("sides") : "file"]
  get("status").textContent = `${get("name").textContent}, ${part} at ${times(camera.zoom)}${pressed("ellipses") ? ", with Gaussians" : ""}${mask && pressed("mask") ? ", exact part marked" : ""}`
  get("border").hidden = !info || !original || chosen("sides") != "both"
  get("border").style.left = `${border}%`
  get("border").ariaValueNow = String(Math.round(border))
  if (!waiting) requestAnimationFrame(paint)
  waiting = true
}

// Draws a chequerboard under transparent pictures.
let board
function pattern(context) {
  if (!board) {
    const tile = new OffscreenCanvas(24, 24), squares = tile.getContext("2d")
    squares.fillStyle = "#c8c8c8"
    squares.fillRect(0, 0, 24, 24)
    squares.fillStyle = "#f2f2f2"
    for (const at of [0, 12]) squares.fillRect(at, at, 12, 12)
    board = context.createPattern(tile, "repeat")
  }
  return board
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
  // The graphics device renders only Gaussians.
  const byDevice = !!info && layer() == "off" && (device?.can(view) ?? false)
  stage.dataset.drawn = byDevice ? device.name : "decoder"
  if (byDevice) {
    device.draw(view)
    context.drawImage(device.canvas, 0, 0)
  } else if (drawn) {
    const [left, top, w, h] = drawn.region, [x0, y0, x1, y1] = [x + left * k, y + top * k, x + (left + w) * k, y + (top + h) * k].map(Math.round)
    context.drawImage(drawn.canvas, x0, y0, x1 - x0, y1 - y0)
  }
  if (original && (!info || chosen("sides") != "file")) {
    const from = info && chosen("sides") == "both" ? Math.round(width * border / 100) : 0
    context.save()
    context.beginPath()
    context.rect(from, 0, width - from, height)
    context.clip()
    // Pixels are shown as squares if they are enlarged enough to be visible.
    context.imageSmoothingEnabled = k * shape.width < 3 * original.width
    context.imageSmoothingQuality = "high"
    context.clearRect(0, 0, width, height)
    context.drawImage(original, x, y, shape.width * k, shape.height * k)
    context.restore()
  }
  if (shape.alpha) {
    context.save()
    context.globalCompositeOperation = "destination-over"
    context.fillStyle = pattern(context)
    context.fillRect(x, y, shape.width * k, shape.height * k)
    context.restore()
  }
  const marks = overlay.getContext("2d")
  marks.clearRect(0, 0, overlay.width, overlay.height)
  if (info && pressed("mask")) mask?.draw(marks, place())
  if (info && pressed("ellipses")) drawEllipses(marks, all, place(), devicePixelRatio, tones[chosen("colours")])
  if (byDevice) stage.dispatchEvent(new Event("drawn"))
  else redraw()
}

// Decodes one view at a time, and then the view that is current by then.
async function redraw() {
  if (busy) return stale = true
  if (!file) return
  const region = camera.visible(), from = file, scale = camera.zoom * devicePixelRatio
  if (!region) return
  // At a high zoom, a pixel of the picture is larger than the stage. The number of samples is bounded, and the browser scales the result.
  const width = Math.max(1, Math.min(Math.round(region[2] * scale), 4096)), height = Math.max(1, Math.min(Math.round(region[3] * scale), 4096))
  const detail = layer(), key = [...region, width, height, detail].join()
  if (drawn?.key == key && drawn.from == from) return
  busy = true
  try {
    const image = await decoder.decode(from, { region, width, height, detail }), canvas = new OffscreenCanvas(width, height)
    canvas.getContext("2d", { colorSpace: image.colorSpace }).putImageData(image, 0, 0)
    if (from == file) drawn = { canvas, region, key, from }
  } catch (error) {
    if (from == file) tell("This view cannot be drawn", `The decoder says: ${error.message}.`)
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

function toggle(id) {
  if (!info) return
  get(id).ariaPressed = String(!pressed(id))
  offer()
}
// Selects the next available choice.
function next(name) {
  const choices = [...document.querySelectorAll(`input[name=${name}]:enabled`)].map(choice => choice.value)
  choose(name, choices[(choices.indexOf(chosen(name)) + 1) % choices.length])
  offer()
}
function moveBorder(to) {
  border = Math.min(Math.max(to, 0), 100)
  show()
}
// Switches between the original alone and the file alone.
function flip() {
  if (!original) return
  choose("sides", chosen("sides") == "original" ? "file" : "original")
  offer()
}
function panel(open = get("panel").hidden) {
  if (open && !info) return
  get("panel").hidden = !open
  if (open) tuck(true)
  get("panel").style.translate = ""
  get("facts").ariaExpanded = String(open)
}
function back() {
  if (!get("message").hidden) dismiss()
  else if (!get("panel").hidden) panel(false)
  else if (maker?.busy) maker.cancel()
}

// Shows the controls of the encoder if a picture is or was encoded; they can be collapsed.
const isMade = () => !get("settings").hidden
function settings(there = false) {
  get("settings").hidden = !there
  tuck(!there)
}
function tuck(away) {
  get("maker").hidden = away
  get("settings").ariaExpanded = String(!away)
  if (!away) panel(false)
}
// Labels the sides of the border.
function label(ours = "", theirs = "") {
  const [left, right] = get("border").querySelectorAll("span")
  left.textContent = `ssplat${ours}`
  right.textContent = `original${theirs}`
}

// The interface of this page for the maker. The page of one file has no encoder.
const maker = get("held-file") ? undefined : new Maker({
  stage(bitmap, name, alpha) {
    ;[file, info, all, mask, drawn] = []
    for (const id of ["ellipses", "facts"]) get(id).disabled = true
    get("ellipses").ariaPressed = "false"
    occupy({ width: bitmap.width, height: bitmap.height, alpha }, name)
    get("summary").textContent = `${bitmap.width} × ${bitmap.height}`
    settings(true)
    original = bitmap
    choose("sides", "both")
    camera.take(bitmap.width, bitmap.height)
    offer()
    stage.focus()
  },
  show: open,
  decode: bytes => decoder.decode(bytes),
  tell,
  resume() {
    if (!shape) welcome()
  },
})

// The keys and their actions, in the order in which they are shown, and whether they also work without a file.
const keys = [
  [["+", "-"], "zoom in, zoom out", { "+": () => camera.zoomBy(1.25), "=": () => camera.zoomBy(1.25), "-": () => camera.zoomBy(.8) }],
  [["←", "→", "↑", "↓"], "move", { ArrowLeft: () => camera.move(64, 0), ArrowRight: () => camera.move(-64, 0), ArrowUp: () => camera.move(0, 64), ArrowDown: () => camera.move(0, -64) }],
  [["0"], "fit the window", { 0: () => camera.fit() }],
  [["1"], "actual size", { 1: () => camera.actual() }],
  [["G"], "Gaussians as ellipses", { g: () => toggle("ellipses") }],
  [["M"], "mark the part of the picture that is stored without loss", { m: () => mask && toggle("mask") }],
  [["L"], "cycle through picture, Gaussians and detail", { l: () => hasLayers() && next("layers") }],
  [["C"], "colour Gaussians by colour, bits or error", { c: () => pressed("ellipses") && next("colours") }],
  [["X"], "switch between the file and its original", { x: flip }],
  [["S"], "cycle through side by side, file and original", { s: () => original && next("sides") }],
  [["[", "]"], "move the border to the original", { "[": () => moveBorder(border - 5), "]": () => moveBorder(border + 5) }],
  [["I"], "facts about the file", { i: () => panel() }],
  [["E"], "size, quality and effort", { e: () => isMade() && tuck(!get("maker").hidden) }],
  [["D"], "save the encoded file", { d: () => isMade() && get("save").click() }],
  [["O"], "open a file", { o: () => get("file").click() }, true],
  [["Esc"], "close", { Escape: back }, true],
  [["?"], "these keys", { "?": () => get("help").showModal() }, true],
]
const deeds = Object.assign({}, ...keys.map(([, , deeds]) => deeds)), always = Object.assign({}, ...keys.filter(row => row[3]).map(([, , deeds]) => deeds))
for (const [names, words] of keys) {
  const row = get("help").querySelector("table").insertRow()
  row.insertCell().append(...names.map(name => Object.assign(document.createElement("kbd"), { textContent: name })))
  row.insertCell().textContent = words
}
addEventListener("keydown", event => {
  const name = event.key.length == 1 ? event.key.toLowerCase() : event.key, deed = (info ? deeds : always)[name]
  if (event.ctrlKey || event.metaKey || event.altKey || !deed || get("help").open) return
  // Arrow keys that select, scroll or move the border do not move the picture.
  if (/^(Arrow|[+-])/.test(name) && event.target.closest?.("input, aside, .middle")) return
  event.preventDefault()
  if (event.target == get("border") && /^Arrow(Left|Right)$/.test(name)) return moveBorder(border + (name == "ArrowLeft" ? -2 : 2))
  deed()
})

for (const [id, deed] of Object.entries({ open: () => get("file").click(), choose: () => get("file").click(), another: () => get("file").click(), dismiss, ellipses: () => toggle("ellipses"), mask: () => toggle("mask"), fit: () => camera.fit(), in: () => camera.zoomBy(1.5), out: () => camera.zoomBy(1 / 1.5), facts: () => panel(), settings: () => tuck(!get("maker").hidden), fold: () => tuck(true), "help-button": () => get("help").showModal() })) get(id).onclick = deed
get("compare").onclick = () => original ? compareWith(undefined) : get("original").click()
get("zoom").onclick = () => camera.fitted ? camera.actual() : camera.fit()
for (const choice of document.querySelectorAll(".choices input")) choice.onchange = offer
for (const id of ["file", "original"]) get(id).onchange = async event => {
  const [chosen] = event.target.files
  if (chosen) await take(await chosen.arrayBuffer(), chosen.name, id == "original")
  // Reset, so that the same file can be chosen again.
  event.target.value = ""
}
get("help").onclick = event => event.target == get("help") && get("help").close()

const handle = get("border")
handle.addEventListener("pointerdown", event => handle.setPointerCapture(event.pointerId))
handle.addEventListener("pointermove", event => {
  const { left, width } = stage.getBoundingClientRect()
  if (event.buttons) moveBorder(100 * (event.clientX - left) / width)
})

// On phones, the facts are a sheet that can be pulled down.
let pulled
get("grip").addEventListener("pointerdown", event => {
  get("grip").setPointerCapture(event.pointerId)
  pulled = event.clientY
})
get("grip").addEventListener("pointermove", event => {
  if (pulled != undefined) get("panel").style.translate = `0 ${Math.max(0, event.clientY - pulled)}px`
})
for (const name of ["pointerup", "pointercancel"]) get("grip").addEventListener(name, event => {
  if (event.clientY - pulled > 60) panel(false)
  else get("panel").style.translate = ""
  pulled = undefined
})
get("grip").onclick = () => panel(false)

addEventListener("paste", async event => {
  const [file] = event.clipboardData.files
  if (file) await take(await file.arrayBuffer(), file.name || "pasted.png")
})
addEventListener("dragover", event => {
  event.preventDefault()
  get("drop").hidden = false
})
addEventListener("dragleave", event => get("drop").hidden = !event.relatedTarget)
addEventListener("drop", async event => {
  event.preventDefault()
  get("drop").hidden = true
  const files = await Promise.all([...event.dataTransfer.files].map(async f => [await f.arrayBuffer(), f.name]))
  // If two files are dropped, the .ssplat file is handled first.
  files.sort(([, a], [, b]) => b.endsWith(".ssplat") - a.endsWith(".ssplat"))
  for (const [bytes, name] of files.slice(0, 2)) await take(bytes, name)
})
let side = ""
new ResizeObserver(() => {
  const now = `${stage.clientWidth} ${stage.clientHeight}`
  if (now != side) camera.fitted ? camera.fit() : show()
  side = now
}).observe(stage)

async function fetched(url) {
  const name = url.split("/").pop(), response = await fetch(url).catch(error => ({ statusText: error.message }))
  if (response.ok) return take(await response.arrayBuffer(), name)
  tell(`${name} was not found`, `The server says: ${response.status ?? ""} ${response.statusText}.`, url)
}
const draw = asked.get("draw"), takes = name => !draw || draw == name
// Sets the device, and gives it the current file.
function use(next) {
  device = next || takes("webgl") && Splatting.create() || undefined
  if (next) next.onlost = () => use()
  if (all) device?.load(all, info.blend, colorSpace(info.icc, info.cicp))
  show()
}
if (!get("held-file") && !asked.get("file")) {
  welcome()
  Maker.prepare()
}
use(takes("webgpu") && await WebGpuSplatting.create(draw == "webgpu"))
for (const id of ["file", "original"]) {
  const inside = held(`held-${id}`)
  if (inside) await take(inside, get(`held-${id}`).dataset.name)
  else if (asked.get(id)) await fetched(asked.get(id))
}
