// Pictures of the browser's formats to pixels for the encoder.

// Most pixels that are taken: the encoder's memory is bounded, and so is the browser's.
const most = 2 ** 26
// Pixels that are read at a time, so that the page answers in between.
const piece = 2 ** 22

export class PictureError extends Error {}

const rest = () => new Promise(resolve => setTimeout(resolve))

// The size of a picture, from its header: it is not decoded for that.
async function sizeOf(blob) {
  const image = new Image(), url = URL.createObjectURL(blob)
  try {
    await new Promise((resolve, reject) => Object.assign(image, { onload: resolve, onerror: reject, src: url }))
    return [image.naturalWidth, image.naturalHeight]
  } catch {
    throw new PictureError("This browser cannot show it: the file is broken, too large, or of a format that the browser does not know.")
  } finally {
    URL.revokeObjectURL(url)
  }
}

// Samples in sRGB: RGBA where something can be seen through, else RGB.
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

// Reads a picture, upright: what a canvas draws, and the samples for the encoder.
export async function readPicture(blob, signal) {
  const [width, height] = await sizeOf(blob), count = v => (v / 1e6).toFixed(0)
  signal?.throwIfAborted()
  if (width * height > most)
    throw new PictureError(`It has ${count(width * height)} megapixels. This page takes up to ${count(most)}; the program ssplat takes larger ones.`)
  // A drawing of vectors may have no size.
  if (!width || !height) throw new PictureError("It has no size in pixels.")
  let bitmap
  try {
    bitmap = await createImageBitmap(blob)
  } catch {
    throw new PictureError("This browser cannot decode it: the file is broken, or too large for the memory.")
  }
  signal?.throwIfAborted()
  try {
    return { bitmap, pixels: await samplesOf(bitmap, 3, signal) }
  } catch (error) {
    if (error instanceof RangeError) throw new PictureError("It does not fit into the memory of this browser.")
    throw error
  }
}

// The samples of a decoded file in the channels of the picture that it was made of.
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
