// .ssplat files in the browser and in Node.js: decode, header, gaussians and info by WebAssembly, here or in a worker.
import { SsplatError } from "./error.js"
import { Machine, compile } from "./machine.js"
import { colorSpace } from "./icc.js"

export { SsplatError, compile, colorSpace }

// Pixels as ImageData where there is such a thing, in the canvas's colour space for the profile of the file.
function asImage({ data, width, height, ...facts }) {
  if (typeof ImageData == "undefined") return { data, width, height, colorSpace: colorSpace(facts.icc), ...facts }
  return Object.assign(new ImageData(data, width, height, { colorSpace: colorSpace(facts.icc) }), facts)
}

// Draws and describes files. `worker: true` does so beside the page, where there are workers; `module` is the WebAssembly
// as a URL, a Response, bytes or a compiled module, if it is not the file beside this one.
export class Decoder {
  #machine
  #worker
  #waiting = new Map
  #count = 0

  constructor({ worker = false, module } = {}) {
    if (!worker || typeof Worker == "undefined") {
      this.#machine = compile(module).then(module => new Machine(module))
      // Whoever asks first is told.
      this.#machine.catch(() => {})
      return
    }
    this.#worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" })
    this.#worker.onmessage = ({ data: { id, answer, kind, message } }) => {
      const { resolve, reject } = this.#waiting.get(id)
      this.#waiting.delete(id)
      if (kind) reject(new SsplatError(kind, message))
      else resolve(answer)
    }
    this.#worker.onerror = event => this.#stop(`the worker failed: ${event.message}`)
    this.#worker.postMessage({ question: "start", source: module instanceof URL ? module.href : module })
  }

  #stop(words) {
    for (const { reject } of this.#waiting.values()) reject(new SsplatError("internal", words))
    this.#waiting.clear()
    this.#worker?.terminate()
    this.#worker = undefined
    this.#machine = Promise.reject(new SsplatError("internal", words))
    this.#machine.catch(() => {})
  }

  async #ask(question, bytes, options) {
    if (!this.#worker) return (await this.#machine)[question](bytes, options)
    const id = ++this.#count
    return new Promise((resolve, reject) => {
      this.#waiting.set(id, { resolve, reject })
      this.#worker.postMessage({ id, question, bytes, options }, options.into instanceof ArrayBuffer ? [options.into] : [])
    })
  }

  // Pixels, of all or of a `region` [left, top, width, height], `width` and `height` pixels large, in the ArrayBuffer `into` if they fit.
  async decode(bytes, options = {}) {
    const { region, width, height, partial, limits, into } = options
    return asImage(await this.#ask("decode", bytes, { region, width, height, partial, limits, into }))
  }

  // Size, channels, depth, number of primitives, orientation, ICC profile and EXIF block.
  header = (bytes, { limits } = {}) => this.#ask("header", bytes, { limits })

  // Typed arrays of all Gaussians.
  gaussians = (bytes, { limits } = {}) => this.#ask("gaussians", bytes, { limits })

  // Everything of the header, and where the bytes go.
  info = (bytes, { limits } = {}) => this.#ask("info", bytes, { limits })

  // Ends the worker; what was asked and not answered fails.
  close() {
    this.#stop("the decoder was closed")
  }
}

let shared
const here = () => shared ??= new Decoder

export const decode = (bytes, options) => here().decode(bytes, options)
export const header = (bytes, options) => here().header(bytes, options)
export const gaussians = (bytes, options) => here().gaussians(bytes, options)
export const info = (bytes, options) => here().info(bytes, options)
