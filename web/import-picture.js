// Shared core of the bundler plugins: turns an import such as "./photo.jpg?quality=70&ssplat" into a cached .ssplat file and the text of a module.
import { createHash, randomUUID } from "node:crypto"
import { mkdir, readFile, readdir, rename, rm, stat, utimes, writeFile } from "node:fs/promises"
import { availableParallelism, totalmem } from "node:os"
import { dirname, join, parse, relative } from "node:path"
import { SsplatError, encodeFile } from "./node.js"

// Targets, which exclude each other.
const targets = ["ratio", "bytes", "psnr", "quality", "gaussians"]
const names = [...targets, "effort", "tune", "seed", "detail", "levels", "maxSide", "placeholder"]

const fail = words => { throw new SsplatError("parameter", words) }
const known = name => names.includes(name) || fail(`no option is called ${name}; there are ${names.join(", ")}`)

// Matches the module ids that import a picture as an .ssplat file.
export const imports = /[?&]ssplat(&|$)/

// Splits a matching module id into path and query; returns undefined for all others.
export function split(id) {
  const at = id.indexOf("?")
  return imports.test(id) ? { path: id.slice(0, at), query: id.slice(at + 1) } : undefined
}

// Checks the names of a plugin's options and separates `cacheDir` from the defaults for all imports.
export function settingsOf({ cacheDir, ...defaults } = {}) {
  Object.keys(defaults).forEach(known)
  return { cacheDir, defaults }
}

// Returns the options of one import. A target in the query replaces the plugin's default target.
function optionsOf(query, defaults) {
  const given = {}
  for (const [name, value] of new URLSearchParams(query)) {
    if (name == "ssplat") continue
    known(name)
    if (Object.hasOwn(given, name)) fail(`${name} is given twice`)
    if (!value.trim()) fail(`${name} has no value`)
    given[name] = Number.isNaN(Number(value)) ? value : Number(value)
  }
  const rest = Object.entries(defaults).filter(([name]) => !(targets.includes(name) && targets.some(target => Object.hasOwn(given, target))))
  return { ...Object.fromEntries(rest), ...given }
}

// Characters that are replaced in file names, because URLs would need escapes for them.
const unsafe = /[^\p{L}\p{N}._-]+/gu

// Number of encodes that run at the same time. Each has its own thread and needs up to a few GiB of memory for a large photograph.
const maxRunning = Math.max(1, Math.min(availableParallelism(), Math.floor(totalmem() / 2 ** 31)))
const waiting = []
let running = 0
async function inTurn(work) {
  if (running < maxRunning) running++
  else await new Promise(resolve => waiting.push(resolve))
  try {
    return await work()
  } finally {
    if (waiting.length) waiting.shift()()
    else running--
  }
}

// Size of the largest picture file that is read, bytes.
const maxFile = 2 ** 30

// Reads a picture, but no device, no folder and no file that is too large for a picture.
async function contentOf(path) {
  const facts = await stat(path)
  if (!facts.isFile()) fail("not a file")
  if (facts.size > maxFile) fail(`${facts.size} bytes are more than the ${maxFile} that a picture file may have`)
  return readFile(path)
}

let version
const packageVersion = () => version ??= readFile(new URL("./package.json", import.meta.url), "utf8").then(text => JSON.parse(text).version)

// Returns the cache entry in `folder`, or undefined if there is none or it is incomplete.
async function cached(folder, name) {
  try {
    const facts = JSON.parse(await readFile(join(folder, "facts.json"), "utf8")), file = join(folder, name)
    if ((await stat(file)).size != facts.bytes) return
    // The time of the last use, for `removeUnused`.
    await utimes(folder, new Date(), new Date()).catch(() => {})
    return { file, ...facts }
  } catch {
    return undefined
  }
}

// Removes entries and drafts that no build has used for this many days; once for each cache.
const maxAge = 90, cleaned = new Set()
async function removeUnused(cacheDir) {
  if (cleaned.has(cacheDir)) return
  cleaned.add(cacheDir)
  const entries = (await readdir(cacheDir).catch(() => [])).filter(name => /^[0-9a-f]{32}(-[0-9a-f-]{36})?$/.test(name))
  for (const entry of entries.map(name => join(cacheDir, name)))
    if (Date.now() - (await stat(entry).catch(() => ({}))).mtimeMs > maxAge * 86_400_000) await rm(entry, { recursive: true, force: true })
}

// Encodes into a temporary folder and renames it, so that other processes never see an incomplete entry.
async function encodeInto(folder, name, content, options) {
  const { bytes, width, height, placeholder, report } = await inTurn(() => encodeFile(content, options))
  const facts = { bytes: bytes.length, width, height, placeholder, report }, draft = `${folder}-${randomUUID()}`
  await mkdir(draft, { recursive: true })
  try {
    await writeFile(join(draft, name), bytes)
    await writeFile(join(draft, "facts.json"), JSON.stringify(facts))
    // Either the existing entry is incomplete, or another process has written the same entry meanwhile.
    if (!await cached(folder, name)) {
      await rm(folder, { recursive: true, force: true })
      await rename(draft, folder).catch(async error => { if (!await cached(folder, name)) throw error })
    }
  } finally {
    await rm(draft, { recursive: true, force: true })
  }
  await removeUnused(dirname(folder))
  return { file: join(folder, name), ...facts }
}

const underway = new Map()

// Returns the cache entry of an import: { file, bytes, width, height, placeholder }. Calls `log` before and after an encode.
export async function importPicture(path, query, { cacheDir, defaults }, log) {
  try {
    const options = optionsOf(query, defaults), content = await contentOf(path), name = `${parse(path).name.replace(unsafe, "-")}.ssplat`
    const asked = JSON.stringify([await packageVersion(), name, Object.entries(options).sort(([a], [b]) => a < b ? -1 : 1)])
    const folder = join(cacheDir, createHash("sha256").update(asked).update(content).digest("hex").slice(0, 32))
    const found = await cached(folder, name)
    if (found) return found
    // Another import may already be encoding the same.
    if (underway.has(folder)) return await underway.get(folder)
    const shown = relative(process.cwd(), path)
    log(`${shown}: encoding`)
    underway.set(folder, encodeInto(folder, name, content, options).finally(() => underway.delete(folder)))
    const made = await underway.get(folder)
    log(`${shown}: ${made.width} × ${made.height} pixels in ${made.bytes} bytes, ${made.report.seconds.toFixed(1)} s`)
    return made
  } catch (error) {
    // For wrong options the message includes the query, otherwise only the file.
    const place = ["parameter", "size"].includes(error.kind) ? `${path}?${query}` : path
    throw error instanceof SsplatError ? new SsplatError(error.kind, `${place}: ${error.message.replace(/^the picture: /, "")}`) : error
  }
}

// Returns the source text of the imported module. `source` is the expression for the URL; `head` precedes the export.
export const moduleText = (head, source, { width, height, placeholder }) =>
  `${head}\nexport default { src: ${source}, width: ${width}, height: ${height}, placeholder: ${JSON.stringify(placeholder)} }\n`
