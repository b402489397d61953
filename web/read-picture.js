// Picture files to pixels in Node.js, by `sharp`, which whoever uses this installs beside this package.
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises"
import { createRequire } from "node:module"
import { tmpdir } from "node:os"
import { join, resolve } from "node:path"
import { fileURLToPath } from "node:url"
import { SsplatError } from "./error.js"

// Pixels along the longer side that placeholders are made from, as by `ssplat placeholder`.
const placeholderSide = 512
// Largest profile that is compared with sRGB, bytes; larger ones are tables for printers.
const maxComparedProfile = 1 << 16
// Steps of each channel in the comparison.
const gridSteps = 17

let loaded
// `sharp` beside this package, or beside the project that is built: a linked package finds only its own dependencies.
function loadSharp() {
  loaded ??= import("sharp").then(({ default: sharp }) => sharp, error => {
    if (error.code != "ERR_MODULE_NOT_FOUND") throw error
    return createRequire(resolve("package.json"))("sharp")
  })
  return loaded.catch(error => {
    loaded = undefined
    const isMissing = error.code == "ERR_MODULE_NOT_FOUND" || error.code == "MODULE_NOT_FOUND"
    throw new SsplatError("dependency", isMissing ? "pictures are read by the package sharp, which is not installed: npm install sharp" : `the package sharp does not load: ${error.message}`)
  })
}

// Whether a profile means sRGB: every colour of a grid, or every grey, has the same code values in both, within one.
async function isSrgb(sharp, icc, isGrey) {
  if (icc.length > maxComparedProfile) return false
  const count = isGrey ? 256 : gridSteps ** 3, greyOrGrid = (i, k) => isGrey ? i : Math.floor(i / gridSteps ** k) % gridSteps * 255 / (gridSteps - 1)
  const colors = Uint8Array.from({ length: 3 * count }, (_, i) => greyOrGrid(Math.floor(i / 3), i % 3))
  // sharp takes profiles from files only.
  const folder = await mkdtemp(join(tmpdir(), "ssplat-"))
  try {
    const path = join(folder, "profile.icc")
    await writeFile(path, icc)
    const { data, info: { channels } } = await sharp(colors, { raw: { width: count, height: 1, channels: 3 } }).withIccProfile(path).raw().toBuffer({ resolveWithObject: true })
    return data.length == channels * count && data.every((v, i) => Math.abs(v - colors[3 * Math.floor(i / channels) + i % channels]) <= 1)
  } catch {
    return false
  } finally {
    await rm(folder, { recursive: true })
  }
}

// The profile that the file is to carry: one for these channels that is not sRGB.
async function profileToKeep(sharp, icc, isGrey) {
  if (!icc || icc.toString("latin1", 16, 20) != (isGrey ? "GRAY" : "RGB ")) return undefined
  return await isSrgb(sharp, icc, isGrey) ? undefined : new Uint8Array(icc)
}

// Samples of an image as the encoder takes them.
async function samplesOf(image, { isGrey, isDeep, hasAlpha }) {
  // sharp drops the alpha of grey with 8 bits; of RGB it keeps it.
  const isWidened = isGrey && hasAlpha && !isDeep
  const space = isGrey && !isWidened ? isDeep ? "grey16" : "b-w" : isDeep ? "rgb16" : "srgb"
  const { data, info: { width, height, channels } } = await image.toColourspace(space).raw({ depth: isDeep ? "ushort" : "uchar" }).toBuffer({ resolveWithObject: true })
  if (isWidened) return { width, height, channels: 2, data: Uint8Array.from({ length: 2 * width * height }, (_, i) => data[i % 2 ? 2 * i + 1 : 2 * i]) }
  if (!isDeep) return { width, height, channels, data: new Uint8Array(data.buffer, data.byteOffset, data.byteLength) }
  return { width, height, channels, data: new Uint16Array(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength)) }
}

// Reads a picture: a path, a URL of a file, or the bytes of one. `pixels` are upright, at most `maxSide` pixels along the longer side,
// with 8 or 16 bits as the file has them, in the colour space of `icc`; CMYK and Lab become sRGB. `small()` gives those of a placeholder.
export async function readPicture(input, maxSide) {
  const sharp = await loadSharp(), name = input instanceof Uint8Array ? "the picture" : input instanceof URL ? fileURLToPath(input) : input
  const file = input instanceof Uint8Array ? input : await readFile(input)
  try {
    const { space, depth, icc, hasAlpha } = await sharp(file).metadata()
    const kind = { isGrey: space == "b-w" || space == "grey16", isDeep: depth != "uchar", hasAlpha }
    // Colours of printers are converted by their profile; others stay as they are, beside theirs.
    const isDevice = space == "cmyk" || space == "lab" || space == "labs"
    const upright = ignoreIcc => sharp(file, { ignoreIcc }).rotate()
    const within = (image, side) => side ? image.resize({ width: side, height: side, fit: "inside", withoutEnlargement: true }) : image
    const pixels = await samplesOf(within(upright(!isDevice), maxSide), kind)
    const kept = isDevice ? undefined : await profileToKeep(sharp, icc, kind.isGrey)
    // A placeholder has no room for a profile.
    const small = () => samplesOf(within(upright(!kept && !isDevice), placeholderSide), { ...kind, isDeep: false })
    return { pixels, icc: kept, small }
  } catch (error) {
    throw new SsplatError(/pixel limit/.test(error.message) ? "limit" : "format", `${name}: ${error.message}`)
  }
}
