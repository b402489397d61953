// Service worker that answers requests of <img>, srcset, <picture> and CSS for .ssplat files with PNG, so that every part of a browser shows
// them. web/build makes it one classic script, because Firefox runs no modules here. register.js installs it; the service worker of an
// application can load it by importScripts.
import { Machine } from "./machine.js"

// PNG files by the SHA-256 of the .ssplat file, so a file that changes is decoded again.
const store = "ssplat-png-1"
// Limits: bytes of a file, pixels and bytes of a picture, and bytes of all cached pictures.
const maxFile = 1 << 26, maxPixels = 1 << 24, maxMemory = 2 ** 30, maxCached = 1 << 26
const magic = [0x89, 0x53, 0x53, 0x50]

// The query that register.js adds: the URL of the WebAssembly, or nothing if it lies beside this script. Without the query, this is the
// service worker of an application, whose life cycle is left alone.
const module = new URL(location).searchParams.get("ssplat")
const wasm = new URL(module || self.ssplatModule || "ssplat-simd.wasm", location)

let machine
const loaded = () => machine ??= fetch(wasm).then(async response => {
  if (!response.ok) throw new Error(`${wasm}: ${response.status}`)
  const isTyped = /^application\/wasm\b/i.test(response.headers.get("content-type"))
  return new Machine(isTyped ? await WebAssembly.compileStreaming(response) : await WebAssembly.compile(await response.arrayBuffer()))
}).catch(error => {
  machine = undefined
  throw error
})

const table = Uint32Array.from({ length: 256 }, (_, n) => {
  for (let k = 0; k < 8; k++) n = n & 1 ? n >>> 1 ^ 0xEDB88320 : n >>> 1
  return n
})

function crc32(parts) {
  let crc = -1
  for (const bytes of parts) for (let i = 0; i < bytes.length; i++) crc = table[(crc ^ bytes[i]) & 255] ^ crc >>> 8
  return ~crc
}

const long = value => Uint8Array.of(value >>> 24, value >>> 16, value >>> 8, value)
const latin = text => Uint8Array.from(text, c => c.charCodeAt(0))

// A zlib stream without compression, which is faster to write and to read than any other.
function stored(bytes) {
  const parts = [Uint8Array.of(0x78, 1)]
  for (let at = 0; at < bytes.length; at += 65535) {
    const part = bytes.subarray(at, at + 65535), { length } = part
    parts.push(Uint8Array.of(at + 65535 >= bytes.length, length, length >> 8, ~length, ~length >> 8), part)
  }
  let a = 1, b = 0
  for (let at = 0; at < bytes.length;) {
    // The sums stay below 2^32 for this many bytes.
    for (const end = Math.min(bytes.length, at + 5552); at < end; at++) b += a += bytes[at]
    a %= 65521
    b %= 65521
  }
  return [...parts, long((b << 16 | a) >>> 0)]
}

function chunk(name, parts) {
  const all = [latin(name), ...parts]
  return [long(parts.reduce((sum, part) => sum + part.length, 0)), ...all, long(crc32(all))]
}

// Places of the first sample in the stored picture, and of the next ones to the right and below, for each EXIF orientation.
const walks = [
  , () => [0, 1, 1], w => [w - 1, -1, 1], (w, h) => [w * h - 1, -1, -1], (w, h) => [w * (h - 1), 1, -1],
  () => [0, 1, 1], (w, h) => [w * (h - 1), -1, 1], (w, h) => [w * h - 1, -1, -1], w => [w - 1, 1, -1],
]

// Returns a picture of the decoder as PNG: upright, with its code points and ICC profile, and without channels that it does not have.
export function png({ width, height, data, channels, orientation, cicp, icc }) {
  const isTurned = orientation > 4, [columns, rows] = isTurned ? [height, width] : [width, height]
  const [first, x, y] = (walks[orientation] ?? walks[1])(width, height), right = isTurned ? x * width : x, down = isTurned ? y : y * width
  const samples = [, [0], [0, 3], [0, 1, 2], [0, 1, 2, 3]][channels], lines = new Uint8Array(rows * (1 + columns * channels))
  let to = 0
  for (let row = 0; row < rows; row++) {
    // Each row starts with the number of its filter, 0 for none.
    to++
    for (let column = 0, from = 4 * (first + row * down); column < columns; column++, from += 4 * right)
      for (let k = 0; k < channels; k++) lines[to++] = data[from + samples[k]]
  }
  const header = Uint8Array.of(...long(columns), ...long(rows), 8, [, 0, 4, 2, 6][channels], 0, 0, 0)
  const codePoints = cicp?.length ? chunk("cICP", [cicp]) : []
  const profile = icc?.length ? chunk("iCCP", [latin("ICC\0\0"), ...stored(icc)]) : []
  return new Blob([latin("\x89PNG\r\n\x1a\n"), ...chunk("IHDR", [header]), ...codePoints, ...profile, ...chunk("IDAT", stored(lines)), ...chunk("IEND", [])], { type: "image/png" })
}

// Decodes one file at a time, to bound the memory.
let last = Promise.resolve()
const decoded = bytes => last = last.catch(() => {}).then(async () => {
  const decoder = await loaded(), limits = { alloc: maxMemory }, { width, height } = decoder.header(bytes, { limits })
  const scale = Math.sqrt(maxPixels / (width * height))
  return png(decoder.decode(bytes, { limits, ...scale < 1 && { width: Math.max(1, Math.floor(width * scale)) } }))
})

// The key of a picture in the cache; `size` counts for the limit.
const keyOf = (hash, size) => new URL(`/ssplat-png/${hash}?${size}`, location).href

async function cached(hash) {
  return (await caches.open(store)).match(keyOf(hash, 0), { ignoreSearch: true })
}

// Adds a picture to the cache, and removes the oldest ones above the limit.
async function keep(hash, blob) {
  const cache = await caches.open(store)
  await cache.put(keyOf(hash, blob.size), new Response(blob))
  let total = 0
  for (const { url } of (await cache.keys()).reverse()) if ((total += Number(new URL(url).search.slice(1))) > maxCached) await cache.delete(url)
}

const asked = new Map()

// Returns the PNG of a file. Requests for the same file at the same time are decoded once.
function picture(hash, bytes, later) {
  if (!asked.has(hash)) {
    const work = async () => {
      const found = await cached(hash).catch(() => {})
      if (found) return found.blob()
      const blob = await decoded(bytes)
      // A cache that is full or forbidden is no reason to show nothing.
      later(keep(hash, blob).catch(() => {}))
      return blob
    }
    asked.set(hash, work().finally(() => asked.delete(hash)))
  }
  return asked.get(hash)
}

// Reads a body of at most `maxFile` bytes; returns undefined for a longer one.
async function read(body) {
  const parts = [], reader = body.getReader()
  let length = 0
  for (;;) {
    const { done, value } = await reader.read()
    if (done) return new Uint8Array(await new Blob(parts).arrayBuffer())
    parts.push(value)
    if ((length += value.length) > maxFile) return void reader.cancel()
  }
}

async function answer(request, later) {
  const isOurs = new URL(request.url).origin == location.origin
  // The bytes of another origin can only be read with CORS. Like <img crossorigin>, such a request carries no cookies.
  const response = await fetch(isOurs || request.mode == "cors" ? request : new Request(request.url, { mode: "cors", credentials: "same-origin", signal: request.signal })).catch(() => fetch(request))
  const type = response.headers.get("content-type") ?? ""
  if (response.status != 200 || !response.body || /^(text\/|image\/(?!x-ssplat|octet))/.test(type)) return response
  const original = response.clone()
  try {
    const bytes = await read(response.body)
    if (!bytes || magic.some((v, i) => bytes[i] != v)) return original
    const hash = [...new Uint8Array(await crypto.subtle.digest("SHA-256", bytes))].map(v => v.toString(16).padStart(2, "0")).join("")
    const blob = await picture(hash, bytes, later)
    original.body.cancel()
    const name = new URL(request.url).pathname.split("/").pop().replace(/\.ssplat$/, ".png").replace(/[^\w.%~-]/g, "_")
    return new Response(blob, { headers: { "content-type": "image/png", "content-length": blob.size, "content-disposition": `inline; filename*=UTF-8''${name}` } })
  } catch (error) {
    console.error(`ssplat: ${request.url}: ${error.message}`)
    return original
  }
}

// <ssplat-img> and other scripts fetch with the destination "", and get the file.
addEventListener("fetch", event => {
  const { request } = event
  if (request.method != "GET" || request.destination != "image" || request.headers.has("range") || !new URL(request.url).pathname.endsWith(".ssplat")) return
  event.respondWith(answer(request, promise => event.waitUntil(promise)))
})

if (module != null) {
  addEventListener("install", event => {
    // Chromium then sends all other requests to the network without waking this worker.
    event.addRoutes?.([{ condition: { not: { urlPattern: { protocol: "*", hostname: "*", port: "*", pathname: "*.ssplat" } } }, source: "network" }]).catch(() => {})
    event.waitUntil(skipWaiting())
    // Requests wait for it.
    loaded().catch(() => {})
  })
}
// A page asks for it that was loaded before this worker ran, or without it by a forced reload.
addEventListener("message", event => { if (event.data == "ssplat: claim") event.waitUntil(clients.claim()) })
