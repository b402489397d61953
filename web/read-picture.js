// Reads picture files in Node.js with `sharp`, an optional peer dependency.
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises"
import { createRequire } from "node:module"
import { tmpdir } from "node:os"
import { join, resolve } from "node:path"
import { fileURLToPath } from "node:url"
import { SsplatError } from "./error.js"

// Longer side of the picture that a placeholder is made from, pixels; the same as in `ssplat placeholder`.
const placeholderSide = 512
// Size of the largest profile that is compared with sRGB, bytes. Larger profiles consist of tables.
const maxComparedProfile = 1 << 16
// Values per channel in the comparison with sRGB.
const gridSteps = 17

let loaded
// Loads `sharp` from where this package is installed, or from the current project, because a linked package resolves only its own dependencies.
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

// Whether a profile is sRGB: every colour of a grid (or every grey) has the same code values in both, within 1.
async function isSrgb(sharp, icc, isGrey) {
  if (icc.length > maxComparedProfile) return false
  const count = isGrey ? 256 : gridSteps ** 3, greyOrGrid = (i, k) => isGrey ? i : Math.floor(i / gridSteps ** k) % gridSteps * 255 / (gridSteps - 1)
  const colors = Uint8Array.from({ length: 3 * count }, (_, i) => greyOrGrid(Math.floor(i / 3), i % 3))
  // sharp reads profiles only from files.
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

// Returns the profile to store, or undefined if it is for other channels or is sRGB.
async function profileToKeep(sharp, icc, isGrey) {
  if (!icc || icc.toString("latin1", 16, 20) != (isGrey ? "GRAY" : "RGB ")) return undefined
  return await isSrgb(sharp, icc, isGrey) ? undefined : new Uint8Array(icc)
}

// Renders an image to the samples that the encoder takes.
async function samplesOf(image, { isGrey, isDeep, hasAlpha }) {
  // sharp drops the alpha channel of 8-bit grey output, so such pictures are read as RGBA.
  const isWidened = isGrey && hasAlpha && !isDeep
  const space = isGrey && !isWidened ? isDeep ? "grey16" : "b-w" : isDeep ? "rgb16" : "srgb"
  const { data, info: { width, height, channels } } = await image.toColourspace(space).raw({ depth: isDeep ? "ushort" : "uchar" }).toBuffer({ resolveWithObject: true })
  if (isWidened) return { width, height, channels: 2, data: Uint8Array.from({ length: 2 * width * height }, (_, i) => data[i % 2 ? 2 * i + 1 : 2 * i]) }
  if (!isDeep) return { width, height, channels, data: new Uint8Array(data.buffer, data.byteOffset, data.byteLength) }
  return { width, height, channels, data: new Uint16Array(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength)) }
}

// Reads a picture from a path, a file URL or bytes. `pixels` are upright, at most `maxSide` pixels along the longer side, with the bit depth
// of the file (8 or 16), in the colour space of `icc`. CMYK and Lab are converted to sRGB. `small()` returns the pixels for a placeholder.
export async function readPicture(input, maxSide) {
  const sharp = await loadSharp(), name = input instanceof Uint8Array ? "the picture" : input instanceof URL ? fileURLToPath(input) : input
  const file = input instanceof Uint8Array ? input : await readFile(input)
  try {
    const { space, depth, icc, hasAlpha } = await sharp(file).metadata()
    const kind = { isGrey: space == "b-w" || space == "grey16", isDeep: depth != "uchar", hasAlpha }
    // CMYK and Lab are converted by their profile. All other samples stay unchanged, and the profile is stored.
    const isDevice = space == "cmyk" || space == "lab" || space == "labs"
    const upright = ignoreIcc => sharp(file, { ignoreIcc }).rotate()
    const within = (image, side) => side ? image.resize({ width: side, height: side, fit: "inside", withoutEnlargement: true }) : image
    const pixels = await samplesOf(within(upright(!isDevice), maxSide), kind)
    const kept = isDevice ? undefined : await profileToKeep(sharp, icc, kind.isGrey)
    // A placeholder has no room for a profile, so its pixels are converted to sRGB.
    const small = () => samplesOf(within(upright(!kept && !isDevice), placeholderSide), { ...kind, isDeep: false })
    return { pixels, icc: kept, small }
  } catch (error) {
    throw new SsplatError(/pixel limit/.test(error.message) ? "limit" : "format", `${name}: ${error.message}`)
  }
}
