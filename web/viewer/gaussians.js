// Draws Gaussians as ellipses over the picture, coloured by their bits or by the error of the picture at their position.

// Maximum number of ellipses; more could not be distinguished.
const most = 20000

// Draws the ellipses at one standard deviation: `place` is [zoom, left, top] in the canvas's pixels, `tones`, from 0 to 1, colour them from
// blue by yellow to red; without these they have their own colours. Returns their number.
export function ellipses(context, all, [zoom, left, top], scale, tones) {
  let count = 0
  for (let i = 0; i < all.count && count < most; i++) {
    const x = left + all.mean[2 * i] * zoom, y = top + all.mean[2 * i + 1] * zoom
    const [major, minor] = [all.scale[2 * i] * zoom, all.scale[2 * i + 1] * zoom]
    if (x + major < 0 || y + major < 0 || x - major > context.canvas.width || y - major > context.canvas.height) continue
    // In its own colour, between two outlines that separate it from the picture.
    const [r, g, b] = tones ? heat(tones[i]) : own(all, i)
    context.beginPath()
    context.ellipse(x, y, Math.max(major, .5), Math.max(minor, .5), all.rotation[i], 0, 2 * Math.PI)
    context.strokeStyle = r + g + b > 380 ? "#000a" : "#fffa"
    context.lineWidth = 2.5 * scale
    context.stroke()
    context.strokeStyle = `rgb(${r} ${g} ${b})`
    context.lineWidth = scale
    context.stroke()
    count++
  }
  return count
}

const own = (all, i) => [0, all.channels > 2 ? 1 : 0, all.channels > 2 ? 2 : 0].map(k => Math.round(255 * Math.min(Math.max(all.color[4 * i + k], 0), 1)))

function heat(tone) {
  const t = Math.min(Math.max(tone, 0), 1)
  return [255 * Math.min(2 * t, 1), 255 * (t < .5 ? .4 + 1.2 * t : 2 - 2 * t), 255 * Math.max(0, 1 - 2 * t)].map(Math.round)
}

// Errors of 32 code values and more are red.
export const tonesOfErrors = errors => errors.map(e => e / 32)

// Blue is the 5th percentile of the bits, red the 95th.
export function tonesOfBits(bits) {
  const sorted = bits.slice().sort(), [low, high] = [.05, .95].map(part => sorted[Math.floor(part * (bits.length - 1))])
  return bits.map(b => (b - low) / (high - low || 1))
}

// Returns, for each Gaussian, the mean difference of two pictures of the same size, in code values, within the box of one standard
// deviation around it. The pictures may be smaller than the picture of the Gaussians.
export function errorsOf(all, picture, original) {
  const { width, height } = picture, wide = width + 1, sums = new Float64Array(wide * (height + 1))
  for (let y = 0; y < height; y++)
    for (let x = 0, row = 0; x < width; x++) {
      const at = 4 * (y * width + x)
      for (let k = 0; k < 3; k++) row += Math.abs(picture.data[at + k] - original.data[at + k]) / 3
      sums[(y + 1) * wide + x + 1] = sums[y * wide + x + 1] + row
    }
  const within = (v, top) => Math.min(Math.max(v, 0), top)
  return Float32Array.from({ length: all.count }, (_, i) => {
    const c = Math.cos(all.rotation[i]), s = Math.sin(all.rotation[i]), [major, minor] = [all.scale[2 * i], all.scale[2 * i + 1]]
    const ends = (mean, reach, k, side) => {
      const start = within(Math.floor((mean - reach) * k), side - 1)
      return [start, Math.max(start + 1, within(Math.ceil((mean + reach) * k), side))]
    }
    const [x0, x1] = ends(all.mean[2 * i], Math.hypot(major * c, minor * s), width / all.width, width)
    const [y0, y1] = ends(all.mean[2 * i + 1], Math.hypot(major * s, minor * c), height / all.height, height)
    return (sums[y1 * wide + x1] - sums[y0 * wide + x1] - sums[y1 * wide + x0] + sums[y0 * wide + x0]) / ((x1 - x0) * (y1 - y0))
  })
}
