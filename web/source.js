// Where the WebAssembly and the worker's script come from.
// They are files beside this module, by addresses that bundlers see and rewrite (Vite, webpack). A bundler that leaves the addresses as
// they are (esbuild, Rollup) does not bring the files either; then, and in Node.js, both come out of embedded.js, which nobody else loads.
import { SsplatError } from "./error.js"

const simd = () => new URL("./ssplat-simd.wasm", import.meta.url), scalar = () => new URL("./ssplat-scalar.wasm", import.meta.url)

// Whether the files are there. In a bundle this module has another name, and an address that was left as it is lies beside that.
function served() {
  // Not in the words of an address that bundlers look for.
  const { href, protocol } = simd(), here = import.meta.url
  return protocol != "file:" && (/\/source\.js(\?.*)?$/.test(here) || href != new URL("ssplat-simd.wasm", here).href)
}

// A function that needs vector instructions: `i32.const 0; i8x16.splat; i8x16.popcnt`.
const vectors = Uint8Array.of(0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11)

const bytesOf = base64 => Uint8Array.from(atob(base64), c => c.charCodeAt(0))

async function embedded() {
  const { wasm } = await import("./embedded.js")
  return new Response(new Blob([bytesOf(wasm)]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer()
}

// The bytes of an address or of an answer; what cannot be had is an error of the kind "network".
export async function fetched(source, options) {
  const failed = words => new SsplatError("network", words)
  const response = source instanceof Response ? source : await fetch(source, options).catch(error => {
    throw error.name == "AbortError" ? error : failed(`${source}: ${error.message}`)
  })
  if (!response.ok) throw failed(`${response.url || source}: ${response.status} ${response.statusText}`.trim())
  return response
}

// The module that this machine can run, compiled; or that of a URL, a Response, bytes or a module.
export async function compile(source) {
  if (source instanceof WebAssembly.Module) return source
  if (!source) {
    const fast = WebAssembly.validate(vectors)
    if (!served() && !fast) throw new SsplatError("internal", "without vector instructions the decoder needs ssplat-scalar.wasm as its module")
    source = served() ? fast ? simd() : scalar() : await embedded()
  }
  return WebAssembly.compile(source instanceof ArrayBuffer || ArrayBuffer.isView(source) ? source : await (await fetched(source)).arrayBuffer())
}

// The ways to start a worker, the best first.
export const workers = () => [
  // Bundlers know it in these very words.
  ...served() ? [() => new Worker(new URL("./worker.js", import.meta.url), { type: "module" })] : [],
  async () => {
    const { script } = await import("./embedded.js"), url = URL.createObjectURL(new Blob([bytesOf(script)], { type: "text/javascript" }))
    return new Worker(url)
  },
]
