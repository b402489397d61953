// The encoder for the viewer: everything that it needs is fetched once, then pictures are encoded without another request.
// The page of one file (`ssplat view --html`) has no encoder, so that nothing is imported before it is asked for.

// The worker's modules as blobs that import each other.
async function script(name) {
  const response = await fetch(new URL(`../${name}`, import.meta.url))
  if (!response.ok) throw new Error(`${name}: ${response.status} ${response.statusText}`.trim())
  let text = await response.text()
  for (const [words, other] of text.matchAll(/from ["]\.\/([\w-]+\.js)["]/g)) text = text.replace(words, words.replace(`./${other}`, await script(other)))
  return URL.createObjectURL(new Blob([text], { type: "text/javascript" }))
}

let loading
// Fetches all that encoding needs. What could not be fetched is asked for again.
export function load() {
  loading ??= (async () => {
    const [library, url] = await Promise.all([import("../encode.js"), script("encode-worker.js")])
    await library.preload()
    return { ...library, worker: () => new Worker(url, { type: "module" }) }
  })()
  loading.catch(() => { loading = undefined })
  return loading
}

// Where the page's policy forbids workers of blobs, the worker is a file.
let worker
async function work(library, task) {
  try {
    return await task(worker ?? library.worker)
  } catch (error) {
    if (worker || !/^the worker failed/.test(error.message)) throw error
    worker = true
    return task(worker)
  }
}

// Most memory of an encode: pictures of 2²⁶ pixels fit.
const limits = { alloc: 2 ** 32 }

// Encodes pixels: bytes and report.
export async function encode(pixels, options) {
  const library = await load()
  return work(library, worker => library.encode(pixels, { limits, worker, ...options }))
}

// SSIMULACRA2 of `test` against `reference`.
export async function score(reference, test, signal) {
  const library = await load()
  return work(library, worker => library.ssimulacra2(reference, test, { limits, worker, signal }))
}
