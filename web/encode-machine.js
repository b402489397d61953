// Interface to the WebAssembly modules of the encoder and of SSIMULACRA2 (see wasm-encode/src/lib.rs and wasm-score/src/lib.rs). Each
// instance does one job.
import { SsplatError } from "./error.js"

const kinds = [, "limit", "parameter", "size", "cancelled", "internal"]
// In the order of the module's numbers.
const settings = ["ratio", "bytes", "psnr", "quality", "gaussians", "effort", "tune", "time", "seed", "detail", "levels", "lossless"]
const words = { tune: ["psnr", "iq"], detail: ["off", "auto"] }

// The initial memory of a module in pages of 64 KiB; it grows up to the limit.
const least = 64, page = 65536

// Creates an instance for a job, with a separate memory of at most `most` bytes.
function start(module, { alloc }, most = alloc, host = {}) {
  const pages = Math.ceil(most / page)
  if (pages < least) throw new SsplatError("limit", `limits.alloc is ${alloc}, of which ${most} bytes are left, less than the ${least * page} that is needed`)
  const memory = new WebAssembly.Memory({ initial: least, maximum: pages })
  return { wasm: new WebAssembly.Instance(module, { host, env: { memory } }).exports, memory }
}

// Copies bytes to input `which` of an instance.
function put({ wasm, memory }, { alloc }, which, bytes) {
  if (!bytes?.byteLength) return
  const at = wasm.input(which, bytes.byteLength)
  if (!at) throw new SsplatError("limit", `no memory for ${bytes.byteLength} bytes: limits.alloc is ${alloc}`)
  new Uint8Array(memory.buffer, at, bytes.byteLength).set(new Uint8Array(bytes.buffer, bytes.byteOffset, bytes.byteLength))
}

// Runs `work` on an instance, which stops without a message if memory runs out or if it has a fault. A job allocates less than 64 bytes
// per pixel at once, so if more of the `most` bytes is left, it was a fault.
function guarded({ memory }, { width, height, alloc }, most, work) {
  try {
    return work()
  } catch (error) {
    if (!(error instanceof WebAssembly.RuntimeError)) throw error
    throw most - memory.buffer.byteLength > 64 * width * height + 2 ** 20 ? new SsplatError("internal", `the encoder stopped: ${error.message}`)
      : new SsplatError("limit", `the picture needs more than the ${alloc} bytes of limits.alloc`)
  }
}

// Computes the SSIMULACRA2 score of the samples `test` against `data`: `job` is { width, height, channels, depth, data, test, alloc }.
// Pictures with a side below 64 pixels are mirrored before they are measured.
export function score(module, job, most = job.alloc) {
  const instance = start(module, job, most)
  return guarded(instance, job, most, () => {
    put(instance, job, 0, job.data)
    put(instance, job, 1, job.test)
    return instance.wasm.ssimulacra2(job.width, job.height, job.channels, job.depth)
  })
}

// Encodes `job`: { width, height, channels, depth, data, alloc, icc, exif, cicp, orientation, settings }. `scorer` is the module of SSIMULACRA2,
// which only an encode to a quality needs. `progress` receives a stage and the fraction of it that is done; the encode stops if it returns
// true.
export function run({ module, scorer, job }, progress) {
  const { width, height, channels, depth, alloc } = job
  const bytesAt = (at, length) => new Uint8Array(memory.buffer, at, length)
  const host = {
    now: () => performance.now() / 1000,
    progress: (at, length, done) => +(progress(new TextDecoder().decode(bytesAt(at, length)), done) === true),
    // Both modules together take no more than the limit.
    ssimulacra2: (width, height, channels, depth, ...samples) => {
      const [data, test] = samples.map(at => bytesAt(at, width * height * channels * depth / 8))
      return score(scorer, { width, height, channels, depth, data, test, alloc }, alloc - memory.buffer.byteLength)
    },
  }
  const instance = start(module, job, alloc, host), { wasm, memory } = instance
  return guarded(instance, job, alloc, () => {
    for (const [which, bytes] of [job.data, job.icc, job.exif, job.cicp].entries()) if (which < 3 || bytes) put(instance, job, which, bytes)
    for (const [name, value] of Object.entries(job.settings))
      wasm.set(settings.indexOf(name), words[name] ? words[name].indexOf(value) : value)
    const kind = wasm.encode(width, height, channels, depth, job.orientation)
    const piece = which => bytesAt(wasm.piece(which), wasm.piece_length(which)).slice()
    if (kind) throw new SsplatError(kinds[kind], new TextDecoder().decode(piece(0)))
    const lines = which => new TextDecoder().decode(piece(which)).split("\n").filter(line => line).map(line => line.split("\t"))
    const [gaussians, psnr, quality, seconds] = [0, 1, 2, 3].map(k => wasm.number(k))
    return {
      bytes: piece(0),
      report: {
        gaussians, psnr, seconds,
        ...Number.isNaN(quality) ? {} : { quality },
        stages: lines(1).map(([name, microseconds]) => ({ name, seconds: microseconds / 1e6 })),
        leftOut: lines(2).map(([what, bytes]) => ({ what, bytes: +bytes })),
      },
    }
  })
}
