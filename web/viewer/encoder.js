// The encoder for the viewer: its files are fetched once; after that, encodes send no requests. The page of one file (`ssplat view --html`)
// has no encoder, so modules are imported only when they are needed.

// The worker's modules as blobs that import each other.
async function script(name) {
  const response = await fetch(new URL(`../${name}`, import.meta.url))
  if (!response.ok) throw new Error(`${name}: ${response.status} ${response.statusText}`.trim())
  let text = await response.text()
  for (const [words, other] of text.matchAll(/from ["]\.\/([\w-]+\.js)["]/g)) text = text.replace(words, words.replace(`./${other}`, await script(other)))
  return URL.createObjectURL(new Blob([text], { type: "text/javascript" }))
}

let loading
// Fetches everything that encoding needs. Failed requests are repeated by the next call.
export function load() {
  loading ??= (async () => {
    const [library, url] = await Promise.all([import("../encode.js"), script("encode-worker.js")])
    await library.preload({ quality: true })
    return { ...library, worker: () => new Worker(url, { type: "module" }) }
  })()
  loading.catch(() => { loading = undefined })
  return loading
}

// If the page's policy forbids workers from blobs, the worker is loaded from a file.
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

// Maximum memory of an encode, which suffices for pictures of 2²⁶ pixels.
const limits = { alloc: 2 ** 32 }

// Encodes pixels. Returns the bytes and the report.
export async function encode(pixels, options) {
  const library = await load()
  return work(library, worker => library.encode(pixels, { limits, worker, ...options }))
}

// Returns the SSIMULACRA2 score of `test` against `reference`.
export async function score(reference, test, signal) {
  const library = await load()
  return work(library, worker => library.ssimulacra2(reference, test, { limits, worker, signal }))
}
