// Encodes pictures to .ssplat files in browsers and in Node.js, with a separate WebAssembly module that is loaded by the first encode.
// SSIMULACRA2 is another module, which is loaded for encodes to a quality.
import { SsplatError } from "./error.js"
import { run, score } from "./encode-machine.js"

export { SsplatError, names as optionNames }

const targets = ["ratio", "bytes", "psnr", "quality", "gaussians", "lossless"]
const names = [...targets, "effort", "tune", "time", "seed", "detail", "levels", "cicp", "icc", "exif", "orientation", "limits", "worker", "module", "scoreModule", "signal", "onProgress"]
// The quality of a file for which no target is given, as in the program.
const defaultQuality = 70
const bad = words => { throw new SsplatError("parameter", words) }
// Default maximum memory of the WebAssembly in bytes: the limit of the Rust crate on 32-bit systems.
const memory = 2 ** 30, address = 2 ** 32

// The modules are files in the same folder, with URLs that bundlers recognize and rewrite.
const encoder = { simd: () => new URL("./ssplat-encode-simd.wasm", import.meta.url), scalar: () => new URL("./ssplat-encode-scalar.wasm", import.meta.url) }
const scorer = { simd: () => new URL("./ssplat-score-simd.wasm", import.meta.url), scalar: () => new URL("./ssplat-score-scalar.wasm", import.meta.url) }
// A function that needs SIMD instructions: `i32.const 0; i8x16.splat; i8x16.popcnt`.
const vectors = Uint8Array.of(0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11)
const node = name => globalThis.process?.getBuiltinModule?.(`node:${name}`)

async function bytesAt(source) {
  if (source instanceof ArrayBuffer || ArrayBuffer.isView(source)) return source
  const network = words => new SsplatError("network", `${source}: ${words}`)
  try {
    if (node("fs") && new URL(source).protocol == "file:") return await node("fs").promises.readFile(new URL(source))
    const response = await fetch(source)
    if (!response.ok) throw new Error(`${response.status} ${response.statusText}`.trim())
    return await response.arrayBuffer()
  } catch ({ message }) {
    throw network(message)
  }
}

// Returns the module of `files` for this machine, or the one given by a URL, bytes or a module. Failed requests are repeated by the next
// call.
function compile(files, source) {
  if (source instanceof WebAssembly.Module) return source
  if (source) return bytesAt(source).then(bytes => WebAssembly.compile(bytes))
  files.compiled ??= bytesAt(WebAssembly.validate(vectors) ? files.simd() : files.scalar()).then(bytes => WebAssembly.compile(bytes))
  files.compiled.catch(() => { files.compiled = undefined })
  return files.compiled
}

// Check integers and other numbers against a range, which includes both ends.
function within(name, value, least, most, isWhole = true) {
  if (typeof value != "number" || !(value >= least && value <= most) || isWhole && !Number.isInteger(value))
    bad(`${name} is ${value}, not ${isWhole ? "an integer" : "a number"} from ${least} to ${most}`)
  return value
}

// Returns the samples in the module's format: interleaved, 16 bits little-endian.
function samplesOf(pixels) {
  if (typeof pixels != "object" || pixels == null) bad("pixels are no object with width, height and data")
  const { width, height, data } = pixels
  within("width", width, 1, 2 ** 20)
  within("height", height, 1, 2 ** 20)
  const depth = data instanceof Uint8Array || data instanceof Uint8ClampedArray ? 8 : data instanceof Uint16Array ? 16 : bad("data is neither a Uint8Array, a Uint8ClampedArray nor a Uint16Array")
  const channels = pixels.channels ?? data.length / width / height
  if (![1, 2, 3, 4].includes(channels) || data.length != width * height * channels)
    bad(`data has ${data.length} samples, which are not 1 to 4 for each of ${width} × ${height} pixels${pixels.channels == null ? "" : `, or not ${pixels.channels}`}`)
  const bytes = new Uint8Array(data.buffer, data.byteOffset, data.byteLength)
  if (depth == 8 || new Uint8Array(Uint16Array.of(1).buffer)[0]) return { width, height, channels, depth, data: bytes }
  const swapped = bytes.slice()
  for (let i = 0; i < swapped.length; i += 2) [swapped[i], swapped[i + 1]] = [swapped[i + 1], swapped[i]]
  return { width, height, channels, depth, data: swapped }
}

// Checks the bytes of a profile or an EXIF block.
function bytesOf(name, value) {
  if (value == null || value instanceof Uint8Array) return value ?? undefined
  return value instanceof ArrayBuffer ? new Uint8Array(value) : bad(`${name} is neither a Uint8Array nor an ArrayBuffer`)
}

// Returns the maximum memory of the WebAssembly, bytes.
function allocOf({ limits = {} }) {
  const { alloc = memory, ...others } = limits ?? {}
  if (Object.keys(others).length) bad(`no limit of an encode is called ${Object.keys(others)[0]}; there is alloc`)
  return Math.min(within("limits.alloc", alloc, 1, Number.MAX_SAFE_INTEGER), address)
}

function only(names, options) {
  for (const name of Object.keys(options)) if (!names.includes(name)) bad(`no option is called ${name}; there are ${names.join(", ")}`)
}

// Checks all options against their ranges. Returns a job for the module.
function jobOf(pixels, options) {
  only(names, options)
  const given = name => options[name] != null, settings = {}
  const asked = targets.filter(name => given(name) && options[name] !== false)
  if (asked.length > 1) bad(`${asked.join(" and ")} are given, of which a file can have one`)
  const number = (name, least, most, isWhole) => { if (given(name)) settings[name] = within(name, options[name], least, most, isWhole) }
  const word = (name, ...words) => {
    if (given(name)) settings[name] = words.includes(options[name]) ? options[name] : bad(`${name} is ${options[name]}, none of ${words.join(", ")}`)
  }
  if (!asked.length) settings.quality = defaultQuality
  number("ratio", Number.MIN_VALUE, Number.MAX_VALUE, false)
  number("bytes", 1, Number.MAX_SAFE_INTEGER)
  number("psnr", 0, 1000, false)
  number("quality", 0, 100, false)
  number("gaussians", 0, 2 ** 32 - 1)
  number("effort", 1, 9)
  number("time", 0, Number.MAX_VALUE, false)
  number("seed", 0, Number.MAX_SAFE_INTEGER)
  number("levels", 1, 8)
  if (given("lossless")) {
    if (typeof options.lossless != "boolean") bad(`lossless is ${options.lossless}, neither true nor false`)
    if (options.lossless) settings.lossless = 1
  }
  word("tune", "psnr", "iq")
  word("detail", "auto", "off")
  const cicp = bytesOf("cicp", Array.isArray(options.cicp) ? Uint8Array.from(options.cicp) : options.cicp)
  const icc = bytesOf("icc", options.icc), exif = bytesOf("exif", options.exif)
  const orientation = within("orientation", options.orientation ?? 1, 1, 8)
  if (exif && options.orientation != null) bad("exif and orientation are given, of which a file can have one")
  return { ...samplesOf(pixels), cicp, icc, exif, orientation, settings, alloc: allocOf(options) }
}

// Returns a worker of the browser or of Node.js, or one created by `make` in a browser, with a common interface.
function hire(make) {
  const threads = node("worker_threads")
  if (threads) {
    const worker = new threads.Worker(new URL("./encode-worker.js", import.meta.url))
    return {
      post: message => worker.postMessage(message),
      listen: (onMessage, onError) => worker.on("message", onMessage).on("error", onError).on("exit", code => onError(new Error(`the worker ended with ${code}`))),
      end: () => worker.terminate(),
    }
  }
  // Bundlers recognize exactly this expression.
  const worker = typeof make == "function" ? make() : new Worker(new URL("./encode-worker.js", import.meta.url), { type: "module" })
  return {
    post: message => worker.postMessage(message),
    listen: (onMessage, onError) => Object.assign(worker, {
      onmessage: ({ data }) => onMessage(data),
      onerror: event => onError(new Error(event.message || "its script does not load")),
    }),
    end: () => worker.terminate(),
  }
}

const inWorker = (message, { worker: make, signal, onProgress }) => new Promise((resolve, reject) => {
  const worker = hire(make)
  let isOver = false
  const over = settle => value => {
    if (isOver) return
    isOver = true
    signal?.removeEventListener("abort", stop)
    worker.end()
    settle(value)
  }
  const done = over(resolve), fail = over(reject)
  const stop = () => fail(signal.reason)
  signal?.addEventListener("abort", stop)
  worker.listen(({ answer, kind, message: words, stage, done: share }) => {
    if (answer != null) return done(answer)
    if (kind) return fail(new SsplatError(kind, words))
    try {
      onProgress?.(stage, share)
    } catch (error) {
      fail(error)
    }
  }, error => fail(new SsplatError("internal", `the worker failed: ${error.message}`)))
  worker.post(message)
})

// Waits for the modules of a task, { module, scorer }, and runs its job in a worker or in this thread.
async function work({ module, scorer, job }, { signal, onProgress, worker = true }) {
  const [encodes, scores] = await Promise.all([module, scorer])
  signal?.throwIfAborted()
  const task = { module: encodes, scorer: scores, job }
  if (worker) return inWorker({ ...task, isWatched: !!onProgress }, { worker, signal, onProgress })
  if (!encodes) return score(scores, job)
  let thrown
  try {
    return run(task, (stage, done) => {
      try {
        onProgress?.(stage, done)
        signal?.throwIfAborted()
      } catch (error) {
        thrown = { error }
        return true
      }
    })
  } catch (error) {
    throw thrown ? thrown.error : error
  }
}

// Encodes pixels. Resolves to the bytes of the file and the report of the encode.
export async function encode(pixels, options = {}) {
  const job = jobOf(pixels, options)
  options.signal?.throwIfAborted()
  const scores = job.settings.quality == null ? undefined : compile(scorer, options.scoreModule)
  return work({ module: compile(encoder, options.module), scorer: scores, job }, options)
}

// Computes the SSIMULACRA2 score of `test` against `reference`, two pictures of the same size, channels and depth; NaN if a side has
// fewer than 8 pixels.
export async function ssimulacra2(reference, test, options = {}) {
  only(["limits", "worker", "scoreModule", "signal"], options)
  const [job, { data, ...kind }] = [samplesOf(reference), samplesOf(test)]
  for (const name of ["width", "height", "channels", "depth"])
    if (job[name] != kind[name]) bad(`the pictures differ in ${name}: ${job[name]} and ${kind[name]}`)
  options.signal?.throwIfAborted()
  return work({ scorer: compile(scorer, options.scoreModule), job: { ...job, test: data, alloc: allocOf(options) } }, options)
}

// Fetches and compiles the module of the encoder before it is needed, and that of SSIMULACRA2 unless `quality` is false.
export const preload = async ({ quality = true } = {}) => void await Promise.all([compile(encoder), quality && compile(scorer)])
