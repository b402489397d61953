// What a graphics device is given: Gaussians as arrays, and which views of them it can draw (sections 5.2 to 5.5 of the specification).

// Beyond so many deviations a Gaussian is nothing; what is left of it there; and the weight of the background.
export const K = 3.5, cut = Math.exp(-K * K / 2), epsilon = 1 / 128
// The largest step for which a pixel is one sample. Wider views are means of several.
const widest = 1.5
// Most pixels under Gaussians in one drawing: a graphics driver that is busy for seconds is taken for hung.
const mostWork = 2e9
const mostSide = 4096

export class Scene {
  #reach

  // Takes the Gaussians of a file, as `gaussians` gives them, with the blend that `info` tells.
  constructor(all, blend) {
    const { count, channels, mean, scale, rotation } = all, rgba = (v, i) => channels > 2 ? v.subarray(4 * i, 4 * i + 4) : [v[4 * i], v[4 * i], v[4 * i], v[4 * i + 1]]
    const axis = new Float32Array(2 * count), color = new Float32Array(4 * count), reach = this.#reach = new Float32Array(2 * count)
    for (let i = 0; i < count; i++) {
      const [c, s] = [Math.cos(rotation[i]), Math.sin(rotation[i])], [major, minor] = [scale[2 * i], scale[2 * i + 1]]
      axis.set([c, s], 2 * i)
      color.set(rgba(all.color, i), 4 * i)
      reach.set([K * Math.hypot(major * c, minor * s), K * Math.hypot(major * s, minor * c)], 2 * i)
    }
    const facts = { alpha: channels % 2 == 0, normalized: blend == "normalized", sides: [all.width, all.height], background: rgba(all.background, 0) }
    Object.assign(this, { count, mean, scale, axis, color, ...facts })
  }

  // Whether a device whose textures have at most so large a side can draw a view: `step` pixels of the picture are a pixel of the
  // canvas, whose corner lies at (left, top).
  allows({ left, top, step, width, height }, side) {
    if (!(step <= widest) || Math.min(width, height) < 1 || Math.max(width, height) > Math.min(mostSide, side)) return false
    const { count, mean } = this, reach = this.#reach, under = (at, far, start, length) => Math.max(0, Math.min((at + far - start) / step + 2, length) - Math.max((at - far - start) / step - 2, 0))
    let work = 0
    for (let i = 0; i < 2 * count && work <= mostWork; i += 2) work += under(mean[i], reach[i], left, width) * under(mean[i + 1], reach[i + 1], top, height)
    return work <= mostWork
  }
}

// What the variances of Gaussians grow by, in pixels of the picture squared, where a pixel of the canvas is wider than one.
export const growth = step => Math.max(0, step * step - 1) / 12
