// Interface to the WebAssembly module of the encoder (see wasm-encode/src/lib.rs). Each instance does one job.
import { SsplatError } from "./error.js"

const kinds = [, "limit", "parameter", "size", "cancelled", "internal"]
// In the order of the module's numbers.
const settings = ["ratio", "bytes", "psnr", "quality", "primitives", "effort", "tune", "time", "seed", "detail", "levels"]
const words = { tune: ["psnr", "ssim", "iq"], detail: ["off", "auto"] }

// Runs `job`: { width, height, channels, depth, data, alloc }, with { icc, exif, orientation, settings } for an encode, or with `test`, the
// samples of a picture whose SSIMULACRA2 score is computed. `progress` receives a stage and the fraction of it that is done; the encode
// stops if it returns true.
export function run(module, job, progress) {
  let wasm
  const most = Math.ceil(job.alloc / 65536)
  const text = (at, length) => new TextDecoder().decode(new Uint8Array(memory.buffer, at, length))
  const host = {
    now: () => performance.now() / 1000,
    progress: (at, length, done) => +(progress(text(at, length), done) === true),
  }
  // The initial memory of the module, which grows up to the limit.
  const least = 64
  if (most < least) throw new SsplatError("limit", `limits.alloc is ${job.alloc}, less than the ${least * 65536} bytes that any encode takes`)
  const memory = new WebAssembly.Memory({ initial: least, maximum: most })
  try {
    wasm = new WebAssembly.Instance(module, { host, env: { memory } }).exports
    for (const [which, bytes] of [job.data, job.test ?? job.icc, job.exif].entries()) {
      if (!bytes?.byteLength) continue
      const at = wasm.input(which, bytes.byteLength)
      if (!at) throw new SsplatError("limit", `no memory for ${bytes.byteLength} bytes: limits.alloc is ${job.alloc}`)
      new Uint8Array(memory.buffer, at, bytes.byteLength).set(new Uint8Array(bytes.buffer, bytes.byteOffset, bytes.byteLength))
    }
    for (const [name, value] of Object.entries(job.settings ?? {}))
      wasm.set(settings.indexOf(name), words[name] ? words[name].indexOf(value) : value)
    const pixels = [job.width, job.height, job.channels, job.depth]
    const kind = job.test ? wasm.ssimulacra2(...pixels) : wasm.encode(...pixels, job.orientation)
    const piece = which => new Uint8Array(memory.buffer, wasm.piece(which), wasm.piece_length(which)).slice()
    if (kind) throw new SsplatError(kinds[kind], new TextDecoder().decode(piece(0)))
    if (job.test) return { score: wasm.number(0) }
    const lines = which => new TextDecoder().decode(piece(which)).split("\n").filter(line => line).map(line => line.split("\t"))
    const [primitives, psnr, quality, seconds] = [0, 1, 2, 3].map(k => wasm.number(k))
    return {
      bytes: piece(0),
      report: {
        primitives, psnr, seconds,
        ...Number.isNaN(quality) ? {} : { quality },
        stages: lines(1).map(([name, microseconds]) => ({ name, seconds: microseconds / 1e6 })),
        leftOut: lines(2).map(([what, bytes]) => ({ what, bytes: +bytes })),
      },
    }
  } catch (error) {
    if (!(error instanceof WebAssembly.RuntimeError)) throw error
    // The module stops without a message if memory runs out or if it has a fault. An encode allocates less than 64 bytes per pixel at once,
    // so if more is left, it was a fault.
    const left = job.alloc - memory.buffer.byteLength
    throw left > 64 * job.width * job.height + 2 ** 20 ? new SsplatError("internal", `the encoder stopped: ${error.message}`)
      : new SsplatError("limit", `the picture needs more than the ${job.alloc} bytes of limits.alloc`)
  }
}
