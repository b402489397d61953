// .ssplat files in the browser and in Node.js: decode, header, gaussians and info by WebAssembly, here or in a worker.
import { SsplatError } from "./error.js"
import { Machine } from "./machine.js"
import { compile, workers } from "./source.js"
import { colorSpace } from "./icc.js"

export { SsplatError, compile, colorSpace }

// Returns pixels as ImageData if it exists, in the canvas colour space for the colours of the file.
function asImage({ data, width, height, ...facts }) {
  if (typeof ImageData == "undefined") return { data, width, height, colorSpace: colorSpace(facts.icc, facts.cicp), ...facts }
  return Object.assign(new ImageData(data, width, height, { colorSpace: colorSpace(facts.icc, facts.cicp) }), facts)
}

// Checks the names of options; an unknown name is an error of the caller.
function only(names, options = {}) {
  for (const name of Object.keys(options)) if (!names.includes(name)) throw new SsplatError("parameter", `no option is called ${name}; there are ${names.join(", ")}`)
  return options
}

// Returns a worker with the module, or undefined if its script does not start.
async function begun(start, module) {
  let worker
  try {
    worker = await start()
    const ready = new Promise((resolve, reject) => Object.assign(worker, { onmessage: resolve, onerror: reject }))
    // The worker may fail before the module has arrived.
    ready.catch(() => {})
    worker.postMessage({ module: await module })
    await ready
    return worker
  } catch {
    worker?.terminate()
  }
}

// Decodes files and returns their properties. `worker: true` uses a worker if workers are available; `module` is the WebAssembly as a URL,
// a Response, bytes or a compiled module, if not that of the package.
export class Decoder {
  #module
  #machine
  #worker
  #waiting = new Map
  #count = 0
  #closed = false

  constructor(options) {
    const { worker = false, module } = only(["worker", "module"], options)
    this.#module = compile(module)
    // The first caller receives the error.
    this.#module.catch(() => {})
    if (worker && typeof Worker != "undefined") (this.#worker = this.#hire()).catch(() => {})
  }

  // Uses the first worker that starts, or none, for example if the page's policy forbids it.
  async #hire() {
    for (const start of workers()) {
      const worker = await begun(start, this.#module)
      await this.#module
      if (!worker) continue
      worker.onmessage = ({ data: { id, answer, kind, message } }) => {
        const { resolve, reject } = this.#waiting.get(id)
        this.#waiting.delete(id)
        if (kind) reject(new SsplatError(kind, message))
        else resolve(answer)
      }
      worker.onerror = event => this.#stop(`the worker failed: ${event.message}`, worker)
      if (this.#closed) worker.terminate()
      return worker
    }
    console.warn("ssplat: no worker starts here, the page's thread decodes")
  }

  #stop(words, worker) {
    worker?.terminate()
    for (const { reject } of this.#waiting.values()) reject(new SsplatError("internal", words))
    this.#waiting.clear()
    this.#closed = words
  }

  async #ask(question, bytes, options) {
    const worker = await this.#worker, module = await this.#module
    if (this.#closed) throw new SsplatError("internal", this.#closed)
    if (!worker) return (this.#machine ??= new Machine(module))[question](bytes, options)
    const id = ++this.#count
    return new Promise((resolve, reject) => {
      this.#waiting.set(id, { resolve, reject })
      worker.postMessage({ id, question, bytes, options }, options.into instanceof ArrayBuffer ? [options.into] : [])
    })
  }

  // Returns the pixels of the whole picture or of a `region` [left, top, width, height], with `width` × `height` pixels, in the ArrayBuffer
  // `into` if they fit.
  async decode(bytes, options) {
    return asImage(await this.#ask("decode", bytes, { ...only(["region", "width", "height", "partial", "limits", "into", "detail"], options) }))
  }

  // Returns size, channels, depth, number of Gaussians, orientation, ICC profile and EXIF block.
  header = async (bytes, options) => this.#ask("header", bytes, { ...only(["limits"], options) })

  // Returns all Gaussians as typed arrays.
  gaussians = async (bytes, options) => this.#ask("gaussians", bytes, { ...only(["limits"], options) })

  // Returns the contents of the header and the distribution of the bytes.
  info = async (bytes, options) => this.#ask("info", bytes, { ...only(["limits"], options) })

  // Ends the worker; pending requests fail.
  close() {
    const words = "the decoder was closed"
    this.#stop(words)
    this.#worker?.then(worker => worker?.terminate(), () => {})
  }
}

let shared
const here = () => shared ??= new Decoder

export const decode = (bytes, options) => here().decode(bytes, options)
export const header = (bytes, options) => here().header(bytes, options)
export const gaussians = (bytes, options) => here().gaussians(bytes, options)
export const info = (bytes, options) => here().info(bytes, options)
