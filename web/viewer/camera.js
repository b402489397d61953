// Position of the picture on the stage: its scale in CSS pixels per pixel, and the position of its corner. Touch, mouse and wheel move it.

const least = 1 / 256, most = 4096
// Margins of a fitted picture in CSS pixels: at the sides, and at the bottom, where the tools are.
const margin = 14, tools = 76

export class Camera {
  zoom = 1
  left = 0
  top = 0
  // Whether the picture has not been moved since it was fitted.
  fitted = true
  #stage
  #size = [0, 0]
  #changed

  // Calls `changed` after each movement.
  constructor(stage, changed) {
    this.#stage = stage
    this.#changed = changed
    this.#listen()
  }

  // Sets the size of the picture and shows all of it.
  take(width, height) {
    this.#size = [width, height]
    this.fit()
  }

  fit() {
    const { clientWidth: w, clientHeight: h } = this.#stage, [width, height] = this.#size
    if (!width || !w) return
    this.zoom = Math.max(least, Math.min((w - 2 * margin) / width, (h - margin / 2 - tools) / height, most))
    ;[this.left, this.top] = [(w - width * this.zoom) / 2, Math.max(margin / 4, (h - tools - height * this.zoom) / 2)]
    this.fitted = true
    this.#changed()
  }

  // Zooms by `factor` and keeps the point (x, y) of the stage where it is.
  zoomBy(factor, x = this.#stage.clientWidth / 2, y = this.#stage.clientHeight / 2) {
    const next = Math.min(Math.max(this.zoom * factor, least), most), k = next / this.zoom
    ;[this.zoom, this.left, this.top] = [next, x - (x - this.left) * k, y - (y - this.top) * k]
    this.move(0, 0)
  }

  // Shows one pixel of the picture as one pixel of the screen.
  actual() {
    this.zoomBy(1 / this.zoom / devicePixelRatio)
  }

  move(dx, dy) {
    // A part of the picture stays within the middle half of the stage, so that it is never lost.
    const within = (start, length, side) => Math.min(Math.max(start, side / 4 - length), side * 3 / 4)
    this.left = within(this.left + dx, this.#size[0] * this.zoom, this.#stage.clientWidth)
    this.top = within(this.top + dy, this.#size[1] * this.zoom, this.#stage.clientHeight)
    this.fitted = false
    this.#changed()
  }

  // Returns the visible part in whole pixels of the picture: left, top, width, height.
  visible() {
    const ends = (start, side, length) => [Math.max(0, Math.floor(-start / this.zoom)), Math.min(length, Math.ceil((side - start) / this.zoom))]
    const [x0, x1] = ends(this.left, this.#stage.clientWidth, this.#size[0]), [y0, y1] = ends(this.top, this.#stage.clientHeight, this.#size[1])
    return x1 > x0 && y1 > y0 ? [x0, y0, x1 - x0, y1 - y0] : undefined
  }

  #listen() {
    const stage = this.#stage, pointers = new Map
    const place = event => {
      const { left, top } = stage.getBoundingClientRect()
      return [event.clientX - left, event.clientY - top]
    }
    // Elements on the stage handle the pointer themselves.
    const ours = event => this.#size[0] && !event.target.closest("button, label, .pill, .middle, #border")
    stage.addEventListener("pointerdown", event => {
      if (!ours(event) || event.button > 1) return
      stage.setPointerCapture(event.pointerId)
      stage.classList.add("moving")
      pointers.set(event.pointerId, place(event))
    })
    stage.addEventListener("pointermove", event => {
      const before = pointers.get(event.pointerId)
      if (!before) return
      const now = place(event), [other] = [...pointers].filter(([id]) => id != event.pointerId).map(([, at]) => at)
      pointers.set(event.pointerId, now)
      if (!other) return this.move(now[0] - before[0], now[1] - before[1])
      // Two fingers zoom by their distance around their centre, and move the picture with it.
      const distance = at => Math.hypot(at[0] - other[0], at[1] - other[1])
      this.move((now[0] - before[0]) / 2, (now[1] - before[1]) / 2)
      if (distance(before) > 1) this.zoomBy(distance(now) / distance(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2)
    })
    for (const name of ["pointerup", "pointercancel"]) stage.addEventListener(name, event => {
      pointers.delete(event.pointerId)
      if (!pointers.size) stage.classList.remove("moving")
    })
    stage.addEventListener("wheel", event => {
      if (event.target.closest(".middle")) return
      event.preventDefault()
      if (this.#size[0]) this.zoomBy(2 ** (-event.deltaY / (event.deltaMode ? 8 : 240)), ...place(event))
    }, { passive: false })
    stage.addEventListener("dblclick", event => {
      if (!ours(event)) return
      if (this.fitted) this.zoomBy(4, ...place(event))
      else this.fit()
    })
  }
}

// Returns the zoom as text.
export function times(zoom) {
  const k = zoom * devicePixelRatio
  return `${k >= 9.95 ? Math.round(k).toLocaleString("en") : k >= .995 ? k.toFixed(1).replace(/\.0$/, "") : k.toFixed(k < .0995 ? 3 : 2)}×`
}
