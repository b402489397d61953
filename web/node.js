// Encodes picture files in Node.js: read-picture.js reads them, encode.js encodes.
import { SsplatError, encode, optionNames } from "./encode.js"
import { readPicture } from "./read-picture.js"

export { SsplatError }

// Options of `encode` that are taken from the picture file.
const fromFile = ["icc", "exif", "orientation"]
const names = [...optionNames.filter(name => !fromFile.includes(name)), "maxSide", "placeholder"]
// Size of the largest file that placeholder.js reads, bytes.
const maxPlaceholder = 1 << 14
// Default of `limits.alloc`: the whole address space of WebAssembly, because a build may use more memory than a page.
const address = 2 ** 32
const bad = words => { throw new SsplatError("parameter", words) }

const whole = (name, value, least, most) => Number.isInteger(value) && value >= least && value <= most ? value : bad(`${name} is ${value}, not an integer from ${least} to ${most}`)

// Encodes a placeholder of at most `most` bytes and returns it as a data URI.
async function placeholderOf(pixels, most, { effort, limits, worker, module, signal }) {
  try {
    // placeholder.js supports only Gaussians.
    const { bytes } = await encode(pixels, { bytes: most, detail: "off", effort, limits, worker, module, signal })
    return `data:image/x-ssplat;base64,${Buffer.from(bytes).toString("base64")}`
  } catch (error) {
    throw error.kind == "size" ? new SsplatError("size", `placeholder: ${error.message}`) : error
  }
}

// Encodes a picture file, or the bytes of one. Its pixels are turned upright by the EXIF orientation.
export async function encodeFile(input, options = {}) {
  if (typeof input != "string" && !(input instanceof URL) && !(input instanceof Uint8Array)) bad("the picture is neither a path, a URL of a file nor a Uint8Array")
  for (const name of Object.keys(options)) if (!names.includes(name)) bad(`no option is called ${name}; there are ${names.join(", ")}`)
  const { maxSide, placeholder = 300, ...rest } = options, settings = { ...rest, limits: { alloc: address, ...rest.limits } }
  if (maxSide != null) whole("maxSide", maxSide, 1, 2 ** 20)
  whole("placeholder", placeholder, 0, maxPlaceholder)
  const { pixels, icc, small } = await readPicture(input, maxSide)
  const { bytes, report } = await encode(pixels, { ...settings, icc })
  const uri = placeholder ? await placeholderOf(await small(), placeholder, settings) : ""
  return { bytes, width: pixels.width, height: pixels.height, placeholder: uri, report }
}
