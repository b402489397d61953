// Interface to the WebAssembly module of the decoder (see wasm/src/lib.rs). A machine handles one request at a time.
import { SsplatError } from "./error.js"

const kinds = [, "format", "version", "limit", "parameter", "internal"]
const limits = ["width", "height", "gaussians", "tilePairs", "work", "overlap", "alloc", "metadata"]
// In the order of the module's numbers.
const layers = ["on", "off", "alone"]
// The memory of a module never shrinks, so after a larger picture the machine is discarded.
const kept = 64 << 20
const whole = (v, what, least = 0) => {
  if (Number.isInteger(v) && v >= least && v < 2 ** 32) return v
  throw new SsplatError("parameter", `${what} is ${v}, not an integer of at least ${least}`)
}

// Beginnings of files that are given instead of an .ssplat file, most often the page that a server sends for a wrong path.
const others = [
  [/^\s*</, "HTML or XML; is the path right?"], [/^\x89PNG/, "a PNG picture"], [/^\xff\xd8\xff/, "a JPEG picture"], [/^GIF8/, "a GIF picture"],
  [/^RIFF....WEBP/s, "a WebP picture"], [/^....ftypavi[fs]/s, "an AVIF picture"], [/^(\xff\x0a|\0\0\0\x0cJXL )/, "a JPEG XL picture"],
  [/^\x1f\x8b/, "compressed with gzip"], [/^version https:\/\/git-lfs/, "a pointer of Git LFS"],
]

// Tells what the file is, if it is not an .ssplat file.
function otherKind(bytes) {
  const start = String.fromCharCode(...bytes.subarray(0, 32))
  if ("\x89SSP".startsWith(start.slice(0, 4))) return
  const known = others.find(([pattern]) => pattern.test(start))
  return known && `not an ssplat file: it is ${known[1]}`
}

export class Machine {
  #module
  #wasm

  constructor(module) {
    this.#module = module
  }

  // Sends one request about a file. Returns [pieces, numbers] of the result.
  #ask(bytes, options, question, ...values) {
    if (!(bytes instanceof Uint8Array)) {
      if (!(bytes instanceof ArrayBuffer)) throw new SsplatError("parameter", "the file is neither a Uint8Array nor an ArrayBuffer")
      bytes = new Uint8Array(bytes)
    }
    let wasm
    try {
      wasm = this.#wasm ??= new WebAssembly.Instance(this.#module).exports
      const at = wasm.input(bytes.length)
      if (!at) throw new SsplatError("limit", `no memory for a file of ${bytes.length} bytes`)
      new Uint8Array(wasm.memory.buffer, at, bytes.length).set(bytes)
      for (const [name, value] of Object.entries(options.limits ?? {})) {
        if (!limits.includes(name) || !(value >= 0)) throw new SsplatError("parameter", `limit ${name} is ${value}`)
        wasm.limit(limits.indexOf(name), value)
      }
      const kind = wasm[question](...values)
      const piece = (k, into) => {
        const from = new Uint8Array(wasm.memory.buffer, wasm.piece(k), wasm.piece_length(k))
        if (!(into?.byteLength >= from.length)) return from.slice()
        const to = new Uint8Array(into, 0, from.length)
        to.set(from)
        return to
      }
      if (kind) throw new SsplatError(kinds[kind], kinds[kind] == "format" && otherKind(bytes) || new TextDecoder().decode(piece(0)))
      const numbers = Array.from({ length: 9 }, (_, k) => wasm.number(k) >>> 0)
      return [[piece(0, options.into), piece(1), piece(2), piece(3), piece(4), piece(5)], numbers]
    } catch (error) {
      if (error instanceof SsplatError) throw error
      // A trap leaves the machine in an unknown state. The most likely cause is that memory ran out.
      this.#wasm = undefined
      throw new SsplatError("internal", `the decoder stopped: ${error.message}`)
    } finally {
      if (wasm?.memory.buffer.byteLength > kept) this.#wasm = undefined
      else this.#wasm?.input(0)
    }
  }

  header(bytes, options = {}) {
    const [[thumbnail, icc, exif, , , cicp], [width, height, channels, depth, gaussians, orientation]] = this.#ask(bytes, options, "header")
    return { width, height, channels, depth, gaussians, orientation, thumbnail, cicp, icc, exif }
  }

  decode(bytes, options = {}) {
    const { region, width, height, partial = false, into, detail = "on" } = options
    if (into && !(into instanceof ArrayBuffer)) throw new SsplatError("parameter", "into is no ArrayBuffer")
    if (!layers.includes(detail)) throw new SsplatError("parameter", `detail is ${detail}, not one of ${layers.join(", ")}`)
    const part = region ? ["left", "top", "width", "height"].map((name, k) => whole(region[k] ?? region[name], `region's ${name}`, k > 1 ? 1 : 0)) : [0, 0, 0, 0]
    // For the module, 0 stands for a side that is not given. A height alone keeps the shape of the part, as a width alone does.
    const out = [[width, "width"], [height, "height"]].map(([v, what]) => v === undefined ? 0 : whole(v, what, 1))
    if (out[1] && !out[0]) {
      const { width: columns, height: rows } = region ? { width: part[2], height: part[3] } : this.header(bytes, { limits: options.limits })
      out[0] = Math.max(1, Math.round(columns * out[1] / rows))
    }
    const [[data, icc, exif, , , cicp], numbers] = this.#ask(bytes, options, "decode", ...part, ...out, partial ? 1 : 0, layers.indexOf(detail))
    const [columns, rows, channels, depth, gaussians, orientation, missing, missingTiles, damaged] = numbers
    const samples = new Uint8ClampedArray(data.buffer, 0, data.length)
    return { width: columns, height: rows, data: samples, channels, depth, gaussians, orientation, missing, missingTiles, damaged: damaged == 1, cicp, icc, exif }
  }

  gaussians(bytes, options = {}) {
    const [[data], [width, height, channels, , count]] = this.#ask(bytes, options, "gaussians"), all = new Float32Array(data.buffer)
    const column = (from, to) => Float32Array.from({ length: count * (to - from) }, (_, i) => all[9 * Math.floor(i / (to - from)) + from + i % (to - from)])
    return { width, height, channels, count, mean: column(0, 2), scale: column(2, 4), rotation: column(4, 5), color: column(5, 9), background: all.slice(9 * count) }
  }

  info(bytes, options = {}) {
    const [[json, icc, exif, each, cells, cicp], numbers] = this.#ask(bytes, options, "info")
    const facts = JSON.parse(new TextDecoder().decode(json)), fields = facts.fields.map(({ name, thousandths }) => ({ name, bits: thousandths / 1000 }))
    const [detail, exact] = [/detail layer/, /exact layer/].map(layer => facts.parts.reduce((sum, { name, bytes }) => layer.test(name) ? sum + bytes : sum, 0))
    return { ...facts, detail, exact, fields, each: new Float32Array(each.buffer), cells, orientation: numbers[5], cicp, icc, exif }
  }
}
