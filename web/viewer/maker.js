// Encodes a picture in a worker with the settings of the controls, and again when they change. The previous result is shown until the next
// one is ready.
import { encode, load, score } from "./encoder.js"
import { size } from "./facts.js"
import { PictureError, likeIn, readPicture } from "./picture.js"

const get = id => document.getElementById(id)
// Delay between the last change of the controls and the start of an encode, milliseconds.
const pause = 350
// Ratio at the middle of the slider, 0, where it starts. 50 steps to the right divide it by ten.
const ratio = 50, steps = 50
// Initial effort by megapixels, so that a photograph of 12 megapixels is encoded within half a minute.
const efforts = [[0.5, 5], [1.5, 3], [3, 2], [Infinity, 1]]
const programEffort = 5
// Names of the encoder's stages.
const stages = { fit: "Fitting Gaussians", finish: "Rounding", detail: "Adding detail", prune: "Removing invisible parts", thumbnail: "Making the thumbnail" }
const grades = [[90, "very high"], [70, "high"], [50, "medium"], [30, "low"], [-Infinity, "very low"]]
const grade = score => grades.find(([least]) => score >= least)[1]

export class Maker {
  #viewer
  #picture
  #name = ""
  // Size of the chosen file, bytes.
  #source = 0
  // The controller that stops the running job, and the timer of the next job.
  #control
  #timer
  // The running job, while it reads a picture.
  #reading
  // The last result: its bytes and settings.
  #made
  #url

  // `viewer` has stage(bitmap, name, alpha), which shows a picture before there is a file; show(bytes, name, bitmap, size), which shows the
  // file; decode(bytes); tell(title, words); and resume(), which restores the previous state if no picture could be read.
  constructor(viewer) {
    this.#viewer = viewer
    for (const id of ["amount", "quality", "effort"]) get(id).addEventListener("input", () => this.#wanted())
    for (const choice of document.querySelectorAll("input[name=target]")) choice.addEventListener("change", () => this.#aim())
    get("cancel").onclick = () => this.cancel()
    get("again").onclick = () => this.#start()
  }

  // Fetches the encoder in advance. A failure is reported when the first picture is encoded.
  static prepare = () => load().catch(() => {})

  get busy() {
    return !!this.#control || !!this.#timer
  }

  // Reads a picture and encodes it at once.
  async take(blob, name, kind) {
    this.#stop()
    const control = this.#control = this.#reading = new AbortController()
    this.#progress("Reading the picture")
    let picture
    try {
      picture = await readPicture(blob, control.signal)
    } catch (error) {
      if (control.signal.aborted) return
      this.#stop()
      this.#rest()
      if (!(error instanceof PictureError)) console.error(error)
      return this.#viewer.tell(`${name} cannot be read`, `It is ${kind}. ${error instanceof PictureError ? error.message : `The browser says: ${error.message}.`}`)
    }
    this.#reading = undefined
    this.#picture = picture
    this.#made = undefined
    this.#source = blob.size
    this.#name = name.replace(/\.[^.]*$/, "") || "picture"
    const { width, height, channels } = picture.pixels
    get("effort").value = efforts.find(([most]) => width * height <= most * 1e6)[1]
    get("note").hidden = get("effort").value == programEffort
    get("note").textContent = `The default here for a picture this large. The default of the program is ${programEffort}, which takes longer and looks better.`
    get("amount").value = 0
    get("quality").value = 70
    document.querySelector("input[name=target][value=size]").checked = true
    for (const id of ["save", "again", "trouble"]) get(id).hidden = true
    for (const id of ["score", "bytes"]) get(id).textContent = "–"
    for (const [id, words] of [["ratio", "file"], ["grade", "SSIMULACRA2"], ["seconds", ""]]) get(id).textContent = words
    this.#viewer.stage(picture.bitmap, name, channels == 4)
    this.#label()
    await this.#start()
  }

  // Discards the picture when another file is shown.
  leave() {
    this.#stop()
    this.#rest()
    this.#picture = this.#made = undefined
    for (const id of ["trouble", "save"]) get(id).hidden = true
  }

  // Stops the running job. The last result remains.
  cancel() {
    const isReading = !!this.#reading
    this.#stop()
    this.#rest()
    if (isReading) this.#viewer.resume()
    if (!this.#picture) return
    get("again").hidden = this.#made?.key == this.#key()
    get("status").textContent = "Stopped"
  }

  #stop() {
    clearTimeout(this.#timer)
    this.#control?.abort()
    this.#timer = this.#control = this.#reading = undefined
  }

  #raw() {
    const { width, height, channels } = this.#picture.pixels
    return width * height * channels
  }

  // Converts a size in bytes to a position of the slider, and back.
  #position = bytes => steps * Math.log10(bytes * ratio / this.#raw())
  #bytes = () => Math.max(1, Math.floor(this.#raw() / ratio * 10 ** (get("amount").value / steps)))

  #target = () => document.querySelector("input[name=target]:checked").value
  #options() {
    const effort = Number(get("effort").value)
    return this.#target() == "quality" ? { quality: Number(get("quality").value), effort } : { bytes: this.#bytes(), effort }
  }
  #key = () => JSON.stringify(this.#options())

  // Shows the values of the controls as text.
  #label() {
    if (!this.#picture) return
    const bytes = this.#bytes(), ratio = this.#raw() / bytes, isQuality = this.#target() == "quality"
    for (const [id, isShown] of [["by-size", !isQuality], ["by-quality", isQuality]]) get(id).hidden = !isShown
    get("amount-value").textContent = size(bytes)
    get("amount").ariaValueText = `${size(bytes)}, a ratio of ${ratio.toPrecision(2)}`
    const quality = get("quality").value
    get("quality-value").textContent = `${quality}, ${grade(quality)}`
    get("quality").ariaValueText = get("quality-value").textContent
    get("effort-value").textContent = get("effort").value
  }

  // A different kind of target starts at the value of the last result, so that no new encode is needed yet.
  #aim() {
    if (this.#made?.score && this.#target() == "quality") get("quality").value = Math.round(this.#made.score)
    if (this.#made && this.#target() == "size") get("amount").value = this.#position(this.#made.bytes.length)
    this.#label()
  }

  #wanted() {
    this.#label()
    get("note").hidden = true
    clearTimeout(this.#timer)
    this.#timer = setTimeout(() => this.#start(), pause)
  }

  async #start() {
    this.#stop()
    const control = this.#control = new AbortController(), { signal } = control, options = this.#options(), key = this.#key(), picture = this.#picture, from = performance.now()
    get("again").hidden = get("trouble").hidden = true
    get("result").ariaBusy = "true"
    this.#progress("Starting")
    try {
      const { bytes, report } = await encode(picture.pixels, { ...options, signal, onProgress: (stage, done) => this.#progress(stages[stage] ?? stage, done) })
      signal.throwIfAborted()
      this.#made = { bytes, key, score: report.quality }
      this.#tell(bytes, (performance.now() - from) / 1000, report.quality)
      await this.#viewer.show(bytes, `${this.#name}.ssplat`, picture.bitmap, this.#source)
      signal.throwIfAborted()
      if (report.quality == null) await this.#measure(bytes, picture.pixels, signal)
    } catch (error) {
      if (signal.aborted) return
      this.#trouble(error)
    }
    if (control == this.#control) {
      this.#control = undefined
      this.#rest()
    }
  }

  // Computes the SSIMULACRA2 score of the decoded file.
  async #measure(bytes, pixels, signal) {
    this.#progress("Measuring the quality")
    const decoded = await this.#viewer.decode(bytes)
    signal.throwIfAborted()
    const value = await score(pixels, await likeIn(decoded, pixels.channels, signal), signal)
    this.#made.score = value
    this.#grade(value)
  }

  #grade(value) {
    get("score").textContent = Number.isNaN(value) ? "–" : value.toFixed(1)
    get("grade").textContent = Number.isNaN(value) ? "too small to measure" : `SSIMULACRA2, ${grade(value)}`
  }

  // Shows the figures of a result, and the link that saves it.
  #tell(bytes, seconds, quality) {
    get("bytes").textContent = size(bytes.length)
    get("ratio").textContent = `a ratio of ${(this.#raw() / bytes.length).toLocaleString("en", { maximumSignificantDigits: 3 })}`
    const share = 100 * bytes.length / this.#source
    get("seconds").textContent = `${share < 99.5 ? `${share.toPrecision(2)} % of the ${size(this.#source)} that you chose, made` : "Made"} in ${seconds.toFixed(seconds < 10 ? 1 : 0)} s`
    if (quality == null) [get("score").textContent, get("grade").textContent] = ["…", "SSIMULACRA2"]
    else this.#grade(quality)
    URL.revokeObjectURL(this.#url)
    this.#url = URL.createObjectURL(new Blob([bytes], { type: "image/x-ssplat" }))
    Object.assign(get("save"), { href: this.#url, download: `${this.#name}.ssplat`, hidden: false })
    get("status").textContent = `${this.#name}.ssplat has ${size(bytes.length)}`
  }

  #trouble({ kind, message }) {
    const words = {
      size: "The picture does not fit into so few bytes. Choose a larger size.",
      limit: "The picture is too large for the memory of this page. The program ssplat supports larger ones.",
      network: "The encoder could not be loaded. Some files of this page may be missing on the server.",
    }
    get("trouble").textContent = words[kind] ?? `The encoder failed: ${message}.`
    get("trouble").hidden = false
    get("again").hidden = kind == "size"
    console.error(message)
  }

  #progress(words, done) {
    get("progress").hidden = false
    const bar = get("done")
    if (done == null) bar.removeAttribute("value")
    else bar.value = done
    get("stage-name").textContent = words
  }

  #rest() {
    get("progress").hidden = true
    get("result").ariaBusy = "false"
  }
}
