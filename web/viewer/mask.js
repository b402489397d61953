// The mask of the exact layer: which cells of the picture are stored without loss (section 12.4 of the specification).

// Side of a cell, pixels.
const side = 8

export class Mask {
  #canvas

  // Takes the facts about a file with an exact layer.
  constructor({ width, height, cells }) {
    const [across, down] = [width, height].map(length => Math.ceil(length / side))
    this.#canvas = new OffscreenCanvas(across, down)
    const image = new ImageData(across, down)
    for (const [k, isCovered] of cells.entries()) image.data.set(isCovered ? [69, 181, 124, 115] : [0, 0, 0, 0], 4 * k)
    this.#canvas.getContext("2d").putImageData(image, 0, 0)
    this.size = [width, height]
  }

  // Tints the covered cells. `k` is the number of canvas pixels for each pixel of the picture, whose corner is at (x, y).
  draw(context, [k, x, y]) {
    const { width, height } = this.#canvas
    context.save()
    context.beginPath()
    context.rect(x, y, k * this.size[0], k * this.size[1])
    context.clip()
    context.imageSmoothingEnabled = false
    context.drawImage(this.#canvas, x, y, k * side * width, k * side * height)
    context.restore()
  }
}
