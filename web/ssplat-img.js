// <ssplat-img src alt placeholder loading width height>: an <img> for .ssplat files, rendered at the size at which it is shown. Other
// pictures are shown by <img>. `placeholder` is a small file, as base64 or data URI, which is shown until the picture has loaded.
import { decode as drawPlaceholder } from "./placeholder.js"
import { Decoder, SsplatError, colorSpace } from "./ssplat.js"
import { fetched } from "./source.js"
// Modules that the others import, so that a browser requests all of them at once.
import "./error.js"
import "./icc.js"
import "./machine.js"

// One worker for all elements of a page.
let shared
const decoder = () => shared ??= new Decoder({ worker: true })

// Media types of other pictures.
const others = /^image\/(?!x-ssplat|octet)/
const magic = [0x89, 0x53, 0x53, 0x50]
// Names of other pictures, for which no decoder is fetched in advance.
const otherNames = /\.(jpe?g|png|webp|avif|gif|svg)([?#]|$)/i

// Widths of placeholders. All of a page appear coarsely at once; then each is rendered finely when the page has time.
const coarse = 64, fine = 192
const later = globalThis.requestIdleCallback ?? (work => setTimeout(work, 50)), refinements = []
function refineNext() {
  refinements.shift()()
  if (refinements.length) later(refineNext)
}
function refineLater(work) {
  if (refinements.push(work) == 1) later(refineNext)
}

const bytesOf = text => Uint8Array.from(atob(text.replace(/^data:[^,]*,/, "").replace(/-/g, "+").replace(/_/g, "/")), c => c.charCodeAt(0))

// Transform of the canvas for each EXIF orientation: x' = a·x + c·y + e, y' = b·x + d·y + f, in sides of the canvas.
const turns = [, , [-1, 0, 0, 1, 1, 0], [-1, 0, 0, -1, 1, 1], [1, 0, 0, -1, 0, 1], [0, 1, 1, 0, 0, 0], [0, 1, -1, 0, 1, 0], [0, -1, -1, 0, 1, 1], [0, -1, 1, 0, 0, 1]]

function paint(canvas, image, orientation = 1) {
  const sides = orientation > 4 ? [image.height, image.width] : [image.width, image.height]
  const settings = { colorSpace: image.colorSpace ?? "srgb" }
  ;[canvas.width, canvas.height] = sides
  const context = canvas.getContext("2d", settings)
  if (orientation < 2) return context.putImageData(image, 0, 0)
  const flat = new OffscreenCanvas(image.width, image.height), [a, b, c, d, e, f] = turns[orientation]
  flat.getContext("2d", settings).putImageData(image, 0, 0)
  context.setTransform(a, b, c, d, e * sides[0], f * sides[1])
  context.drawImage(flat, 0, 0)
}

const style = `
:host { display: inline-block; position: relative; overflow: hidden; vertical-align: bottom; object-fit: fill; max-width: 100% }
:host([hidden]) { display: none }
img, canvas { display: block; width: 100%; height: 100%; object-fit: inherit; object-position: inherit }
[hidden] { display: none }
span { font: inherit; overflow: hidden }`

// Servers that render pages import this module, too, but have no elements.
export class SsplatImg extends (globalThis.HTMLElement ?? class {}) {
  static observedAttributes = ["src", "alt", "placeholder", "loading", "width", "height"]
  #canvas = document.createElement("canvas")
  #img = document.createElement("img")
  #words = document.createElement("span")
  #sheet = new CSSStyleSheet
  #sized = new ResizeObserver(() => this.#redraw())
  #seen = new IntersectionObserver(entries => entries.some(e => e.isIntersecting) && this.#start(), { rootMargin: "50%" })
  #file
  #size = [0, 0]
  #drawn = 0
  #turn = 0
  #preview
  #received
  #complete = true
  #started = ""
  #current = ""
  #stop

  constructor() {
    super()
    const root = this.attachShadow({ mode: "open" })
    this.#sheet.replaceSync(style + ":host {}")
    root.adoptedStyleSheets = [this.#sheet]
    this.#canvas.hidden = this.#img.hidden = this.#words.hidden = true
    root.append(this.#canvas, this.#img, this.#words)
  }

  // Like those of <img>.
  get src() { return this.hasAttribute("src") ? new URL(this.getAttribute("src"), this.baseURI).href : "" }
  set src(v) { this.setAttribute("src", v) }
  get alt() { return this.getAttribute("alt") ?? "" }
  set alt(v) { this.setAttribute("alt", v) }
  get loading() { return this.getAttribute("loading") == "lazy" ? "lazy" : "eager" }
  set loading(v) { this.setAttribute("loading", v) }
  get placeholder() { return this.getAttribute("placeholder") ?? "" }
  set placeholder(v) { this.setAttribute("placeholder", v) }
  get width() { return this.offsetWidth || this.naturalWidth }
  set width(v) { this.setAttribute("width", v) }
  get height() { return this.offsetHeight || this.naturalHeight }
  set height(v) { this.setAttribute("height", v) }
  get naturalWidth() { return this.#size[0] }
  get naturalHeight() { return this.#size[1] }
  get currentSrc() { return this.#current }
  get complete() { return this.#complete }
  decode() {
    return new Promise((resolve, reject) => {
      if (this.#complete) return this.#size[0] ? resolve() : reject(new DOMException("no picture", "EncodingError"))
      this.addEventListener("load", () => resolve(), { once: true })
      this.addEventListener("error", e => reject(e.error), { once: true })
    })
  }

  connectedCallback() {
    this.role ??= "img"
    this.#sized.observe(this)
    this.#load()
  }

  disconnectedCallback() {
    this.#sized.disconnect()
    this.#seen.disconnect()
    this.#stop?.abort()
    this.#started = ""
  }

  attributeChangedCallback(name) {
    if (name == "alt") this.#words.textContent = this.ariaLabel = this.alt
    if (/^(width|height|loading)$/.test(name)) this.#shape()
    if (this.isConnected && /^(src|placeholder|loading)$/.test(name)) this.#load()
  }

  // The default size of the element in CSS pixels, which CSS can override.
  #shape([w, h] = this.#size) {
    const [width, height] = ["width", "height"].map(name => Number(this.getAttribute(name)) || 0)
    const rules = [width && `width: ${width}px`, height && `height: ${height}px`, !width && !height && w && `width: ${w}px`, w && h ? `aspect-ratio: ${w} / ${h}` : width && height && `aspect-ratio: ${width} / ${height}`]
    // Without a height, all pictures of a long page would be close to the viewport and load at once. Until the size is known, the aspect
    // ratio of a photograph is used.
    if (width && !height && !h && this.loading == "lazy") rules.push("aspect-ratio: 3 / 2")
    this.#sheet.deleteRule(this.#sheet.cssRules.length - 1)
    this.#sheet.insertRule(`:host { ${rules.filter(Boolean).join("; ")} }`, this.#sheet.cssRules.length)
  }

  #show(part) {
    this.#preview = undefined
    for (const each of [this.#canvas, this.#img, this.#words]) each.hidden = each != part
  }

  #load() {
    const now = JSON.stringify([this.src, this.getAttribute("placeholder")])
    if (this.#started == now) {
      if (this.loading == "eager" && !this.#complete) this.#start()
      return
    }
    this.#started = now
    this.#stop?.abort()
    this.#stop = undefined
    this.#seen.disconnect()
    this.#file = this.#received = undefined
    this.#complete = !this.src
    this.#current = ""
    const placeholder = this.getAttribute("placeholder")
    if (placeholder) {
      try {
        const bytes = bytesOf(placeholder), draw = size => {
          const { width, height, rgba, picture } = drawPlaceholder(bytes, size)
          paint(this.#canvas, new ImageData(rgba, width, height))
          return picture
        }
        const picture = draw(coarse)
        // The placeholder has the size of its picture.
        this.#shape([picture.width, picture.height])
        this.#show(this.#canvas)
        this.#preview = bytes
        refineLater(() => {
          // Something else may be shown by now.
          const wanted = Math.min(fine, Math.ceil(this.getBoundingClientRect().width * devicePixelRatio))
          if (this.#preview == bytes && wanted > coarse) draw(wanted)
        })
      } catch (error) {
        console.warn("ssplat-img: the placeholder is not shown:", error.message, this)
      }
    }
    if (!this.src) return
    if (this.loading == "lazy") this.#seen.observe(this)
    else this.#start()
  }

  async #start() {
    if (this.#stop) return
    this.#seen.disconnect()
    const stop = this.#stop = new AbortController, { src } = this
    this.#current = src
    try {
      // The decoder is larger than most files, and all of them wait for it.
      if (!otherNames.test(src)) decoder()
      const response = await fetched(src, { signal: stop.signal, priority: this.loading == "lazy" ? "low" : "auto" })
      const bytes = await this.#read(response, stop.signal)
      if (stop.signal.aborted) return
      const type = response.headers.get("content-type") ?? ""
      if (magic.every((v, i) => bytes[i] == v) || !others.test(type)) {
        const { width, height, orientation } = await decoder().header(bytes)
        if (stop.signal.aborted) return
        this.#file = { bytes, width, height, orientation }
        this.#size = orientation > 4 ? [height, width] : [width, height]
        this.#drawn = 0
        this.#shape()
        await this.#redraw()
      } else {
        const url = URL.createObjectURL(new Blob([bytes], { type }))
        try {
          this.#img.src = url
          await this.#img.decode().catch(() => { throw new SsplatError("format", `no picture of the type ${type} that this browser knows`) })
        } finally {
          URL.revokeObjectURL(url)
        }
        if (stop.signal.aborted) return
        this.#size = [this.#img.naturalWidth, this.#img.naturalHeight]
        this.#shape()
        this.#show(this.#img)
      }
      if (stop.signal.aborted) return
      this.#complete = true
      this.#received = undefined
      this.dispatchEvent(new Event("load"))
    } catch (error) {
      if (stop.signal.aborted) return
      this.#file = undefined
      // The intact parts of a broken file, or of one that ends early, are shown.
      if (this.#received && /^(format|network)$/.test(error.kind)) await this.#glimpse(this.#received.slice(), stop.signal)
      if (stop.signal.aborted) return
      this.#complete = true
      this.#size = [0, 0]
      this.#words.textContent = this.alt
      // The placeholder and parts of the picture are more useful than the alternative text.
      if (this.#canvas.hidden) this.#show(this.#words)
      const message = error.message.startsWith(src) ? error.message : `${src}: ${error.message}`
      console.error(`ssplat-img: ${message}`)
      this.dispatchEvent(new ErrorEvent("error", { error, message }))
    }
  }

  // Reads the bytes of a response. An incomplete file with groups or a thumbnail is rendered whenever its bytes have grown by half, and
  // whenever the transfer pauses, so that a complete level appears even if the next one is slow.
  async #read({ body }, signal) {
    if (!body) return new Uint8Array
    const reader = body.getReader()
    let bytes = new Uint8Array(4096), length = 0, looked = 42, looking = false, ended = false, pause = 50, timer
    const soon = () => {
      clearTimeout(timer)
      if (looking || ended || length <= looked) return
      if (length < 1.5 * looked) timer = setTimeout(look, pause)
      else look()
    }
    const look = async () => {
      looking = true
      looked = length
      const start = performance.now()
      try {
        await this.#glimpse(bytes.slice(0, length), signal)
      } finally {
        // On slow connections, at most half of the time is spent on rendering incomplete files.
        pause = Math.max(50, performance.now() - start)
        looking = false
        soon()
      }
    }
    try {
      for (;;) {
        const { done, value } = await reader.read().catch(({ message }) => { throw new SsplatError("network", `the file ends early: ${message}`) })
        if (done) return bytes.subarray(0, length)
        if (length + value.length > bytes.length) {
          const longer = new Uint8Array(Math.max(2 * bytes.length, length + value.length))
          longer.set(bytes)
          bytes = longer
        }
        bytes.set(value, length)
        length += value.length
        this.#received = bytes.subarray(0, length)
        if (length > 63 && magic.every((v, i) => bytes[i] == v) && ((bytes[5] & 3) == 3 || bytes[5] > 127)) soon()
      }
    } finally {
      // The file is complete, or the element no longer shows it.
      clearTimeout(timer)
      ended = true
    }
  }

  // Renders the available part of an incomplete file.
  async #glimpse(bytes, signal) {
    // Too short a part cannot be rendered; errors are reported when the file is complete.
    const { width, height, orientation, thumbnail, cicp, icc, ...kind } = await decoder().header(bytes).catch(() => ({}))
    if (!width || signal.aborted || this.#file) return
    this.#size = orientation > 4 ? [height, width] : [width, height]
    this.#shape()
    const wanted = this.#wanted(orientation)[1], draw = (file, options) => decoder().decode(file, { width: wanted, ...options }).catch(() => undefined)
    let image = await draw(bytes, { partial: true })
    if (thumbnail.length && (!image || image.missing == image.gaussians)) {
      const small = await draw(thumbnail, { height: Math.max(1, Math.round(wanted * height / width)) })
      // The thumbnail has the profile of the picture.
      image = small?.channels == kind.channels && small.depth == kind.depth ? new ImageData(small.data, small.width, small.height, { colorSpace: colorSpace(icc, cicp) }) : undefined
    }
    if (!image || signal.aborted || this.#file || image.gaussians && image.missing == image.gaussians) return
    paint(this.#canvas, image, orientation)
    this.#show(this.#canvas)
  }

  // One sample per device pixel, up to the largest canvas that browsers support, along each side of the element and the file.
  #wanted(orientation) {
    const box = this.getBoundingClientRect(), scale = devicePixelRatio, [w, h] = this.#size
    // Maximum size of the picture for any value of object-fit.
    const cover = Math.max(box.width / w, box.height / h) || 1
    const wanted = Math.max(1, Math.min(Math.ceil(w * cover * scale), 8192, Math.floor(8192 * w / h)))
    return [wanted, orientation > 4 ? Math.max(1, Math.round(wanted * h / w)) : wanted]
  }

  async #redraw() {
    const file = this.#file
    if (!file) return
    const [wanted, width] = this.#wanted(file.orientation)
    if (wanted == this.#drawn) return
    this.#drawn = wanted
    const turn = ++this.#turn
    const image = await decoder().decode(file.bytes, { width }).catch(error => {
      // The previous rendering is kept.
      if (!this.#complete) throw error
      console.error(`ssplat-img: ${this.src}: ${error.message}`)
    })
    if (!image || turn != this.#turn || file != this.#file) return
    paint(this.#canvas, image, file.orientation)
    this.#show(this.#canvas)
  }
}

// The name may already be registered by another copy of the package, or by hot reloading.
if (globalThis.customElements && !customElements.get("ssplat-img")) customElements.define("ssplat-img", SsplatImg)
