// Locates the WebAssembly and the worker's script. They are files in the same folder, with URLs that some bundlers recognize and rewrite
// (Vite, webpack). Other bundlers (esbuild, Rollup) neither rewrite the URLs nor copy the files. In this case, and in Node.js, both come
// from embedded.js, which is not loaded otherwise.
import { SsplatError } from "./error.js"

const simd = () => new URL("./ssplat-simd.wasm", import.meta.url), scalar = () => new URL("./ssplat-scalar.wasm", import.meta.url)

// Whether the files exist. In a bundle, this module has another name, and a URL that was not rewritten is relative to the bundle.
function served() {
  // Written so that bundlers do not recognize it as a URL.
  const { href, protocol } = simd(), here = import.meta.url
  return protocol != "file:" && (/\/source\.js(\?.*)?$/.test(here) || href != new URL("ssplat-simd.wasm", here).href)
}

// A function that needs SIMD instructions: `i32.const 0; i8x16.splat; i8x16.popcnt`.
const vectors = Uint8Array.of(0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11)

const bytesOf = base64 => Uint8Array.from(atob(base64), c => c.charCodeAt(0))

async function embedded() {
  const { wasm } = await import("./embedded.js")
  return new Response(new Blob([bytesOf(wasm)]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer()
}

// Returns the bytes of a URL or a response. Failures are errors of the kind "network".
export async function fetched(source, options) {
  const failed = words => new SsplatError("network", words)
  const response = source instanceof Response ? source : await fetch(source, options).catch(error => {
    throw error.name == "AbortError" ? error : failed(`${source}: ${error.message}`)
  })
  if (!response.ok) throw failed(`${response.url || source}: ${response.status} ${response.statusText}`.trim())
  return response
}

// Returns the compiled module for this machine, or the one given by a URL, a Response, bytes or a module.
export async function compile(source) {
  if (source instanceof WebAssembly.Module) return source
  if (!source) {
    const fast = WebAssembly.validate(vectors)
    if (!served() && !fast) throw new SsplatError("internal", "without vector instructions the decoder needs ssplat-scalar.wasm as its module")
    source = served() ? fast ? simd() : scalar() : await embedded()
  }
  if (source instanceof ArrayBuffer || ArrayBuffer.isView(source)) return WebAssembly.compile(source)
  const response = await fetched(source, { priority: "high" })
  // While it arrives; only with this media type.
  if (WebAssembly.compileStreaming && /^application\/wasm\b/i.test(response.headers.get("content-type"))) return WebAssembly.compileStreaming(response)
  return WebAssembly.compile(await response.arrayBuffer())
}

// The ways to start a worker, in order of preference.
export const workers = () => [
  // Bundlers recognize exactly this expression.
  ...served() ? [() => new Worker(new URL("./worker.js", import.meta.url), { type: "module" })] : [],
  async () => {
    const { script } = await import("./embedded.js"), url = URL.createObjectURL(new Blob([bytesOf(script)], { type: "text/javascript" }))
    return new Worker(url)
  },
]
