// Data for a graphics device: Gaussians as arrays, and the views of them that it can render (sections 5.2 to 5.5 of the specification).

// Number of standard deviations at which a Gaussian ends, its value there, and the weight of the background.
export const K = 3.5, cut = Math.exp(-K * K / 2), epsilon = 1 / 128
// Maximum step at which a pixel is one sample. Larger steps average several samples.
const widest = 1.5
// Maximum number of pixels covered by Gaussians in one drawing. Systems reset a graphics driver that is busy for seconds.
const mostWork = 2e9
const mostSide = 4096

export class Scene {
  #reach

  // Sets the Gaussians of a file, as returned by `gaussians`, and the blend from `info`.
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

  // Returns whether a device with this maximum texture side can render a view. One pixel of the canvas is `step` pixels of the picture; the
  // corner of the canvas is at (left, top).
  allows({ left, top, step, width, height }, side) {
    if (!(step <= widest) || Math.min(width, height) < 1 || Math.max(width, height) > Math.min(mostSide, side)) return false
    const { count, mean } = this, reach = this.#reach, under = (at, far, start, length) => Math.max(0, Math.min((at + far - start) / step + 2, length) - Math.max((at - far - start) / step - 2, 0))
    let work = 0
    for (let i = 0; i < 2 * count && work <= mostWork; i += 2) work += under(mean[i], reach[i], left, width) * under(mean[i + 1], reach[i + 1], top, height)
    return work <= mostWork
  }
}

// Returns the increase of the variances of Gaussians, in squared pixels of the picture, if a pixel of the canvas is larger than one of the
// picture.
export const growth = step => Math.max(0, step * step - 1) / 12
