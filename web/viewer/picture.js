// Converts pictures in the browser's formats to pixels for the encoder.

// Maximum number of pixels, because the memory of the encoder and the browser is limited.
const most = 2 ** 26
// Number of pixels that are read at a time, so that the page stays responsive.
const piece = 2 ** 22

export class PictureError extends Error {}

const rest = () => new Promise(resolve => setTimeout(resolve))

// Returns the size of a picture from its header, without decoding it.
async function sizeOf(blob) {
  const image = new Image(), url = URL.createObjectURL(blob)
  try {
    await new Promise((resolve, reject) => Object.assign(image, { onload: resolve, onerror: reject, src: url }))
    return [image.naturalWidth, image.naturalHeight]
  } catch {
    throw new PictureError("This browser cannot show it: the file is broken, too large, or in a format that the browser does not support.")
  } finally {
    URL.revokeObjectURL(url)
  }
}

// Returns samples in sRGB: RGBA if any pixel is transparent, otherwise RGB.
async function samplesOf(bitmap, channels, signal) {
  const { width, height } = bitmap, rows = Math.max(1, Math.floor(piece / width)), data = new Uint8Array(width * height * channels)
  const canvas = new OffscreenCanvas(width, Math.min(rows, height)), context = canvas.getContext("2d", { willReadFrequently: true })
  for (let top = 0; top < height; top += rows) {
    const part = Math.min(rows, height - top)
    context.clearRect(0, 0, width, part)
    context.drawImage(bitmap, 0, top, width, part, 0, 0, width, part)
    const { data: samples } = context.getImageData(0, 0, width, part)
    if (channels == 4) data.set(samples, 4 * width * top)
    else
      for (let from = 0, to = 3 * width * top; from < samples.length; from += 4, to += 3) {
        if (samples[from + 3] < 255) return samplesOf(bitmap, 4, signal)
        data[to] = samples[from]
        data[to + 1] = samples[from + 1]
        data[to + 2] = samples[from + 2]
      }
    await rest()
    signal?.throwIfAborted()
  }
  return { width, height, channels, data }
}

// Reads a picture and applies its orientation. Returns a bitmap for the canvas and the samples for the encoder.
export async function readPicture(blob, signal) {
  const [width, height] = await sizeOf(blob), count = v => (v / 1e6).toFixed(0)
  signal?.throwIfAborted()
  if (width * height > most)
    throw new PictureError(`It has ${count(width * height)} megapixels. This page takes up to ${count(most)}; the program ssplat supports larger ones.`)
  // A vector drawing may have no size.
  if (!width || !height) throw new PictureError("It has no size in pixels.")
  let bitmap
  try {
    bitmap = await createImageBitmap(blob)
  } catch {
    throw new PictureError("This browser cannot decode it: the file is broken or needs too much memory.")
  }
  signal?.throwIfAborted()
  try {
    return { bitmap, pixels: await samplesOf(bitmap, 3, signal) }
  } catch (error) {
    if (error instanceof RangeError) throw new PictureError("It does not fit into the memory of this browser.")
    throw error
  }
}

// Returns the samples of a decoded file in the channels of its original.
export async function likeIn({ data, width, height }, channels, signal) {
  if (channels == 4) return { width, height, channels, data }
  const samples = new Uint8Array(width * height * channels)
  for (let start = 0; start < width * height; start += piece) {
    for (let i = start; i < Math.min(start + piece, width * height); i++) {
      samples[3 * i] = data[4 * i]
      samples[3 * i + 1] = data[4 * i + 1]
      samples[3 * i + 2] = data[4 * i + 2]
    }
    await rest()
    signal?.throwIfAborted()
  }
  return { width, height, channels, data: samples }
}
