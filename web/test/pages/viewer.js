// What the viewer promises: it opens a file, zooms and pans, and says what is wrong with a broken one.
const patience = 60_000
const until = async what => {
  for (let i = 0; i < patience / 50; i++) {
    const v = what()
    if (v) return v
    await new Promise(r => setTimeout(r, 50))
  }
}

export async function test() {
  const problems = []
  let checks = 0
  const check = (good, words) => {
    checks++
    if (!good) problems.push(words)
  }
  const open = async (file, page = "/web/dist/viewer/index.html") => {
    const frame = document.createElement("iframe")
    frame.src = file ? `${page}?file=${file}` : page
    frame.style = "width: 900px; height: 600px; border: 0"
    document.body.replaceChildren(frame)
    await new Promise(resolve => frame.onload = resolve)
    return frame.contentWindow
  }
  const page = await open("/spec/vectors/valid/coded-rgb/file.ssplat"), get = id => page.document.getElementById(id)
  const stage = get("stage"), pixels = id => get(id).getContext("2d").getImageData(0, 0, get(id).width, get(id).height).data
  const percent = () => parseFloat(/at (\S+) %/.exec(get("status").textContent)?.[1])
  check(await until(() => pixels("picture").some(v => v > 0 && v < 255)), "nothing is drawn")
  check(get("panel").textContent.includes("coded") && get("panel").querySelectorAll("table").length >= 4, "no facts are told")
  check(get("hint").hidden, "the hint stays")

  // Keys zoom, and what is drawn then is as fine as the screen.
  const before = percent(), key = name => stage.dispatchEvent(new page.KeyboardEvent("keydown", { key: name }))
  for (let i = 0; i < 8; i++) key("+")
  check(Math.abs(percent() / before - 1.25 ** 8) < .05 * 1.25 ** 8, `8 steps of 1.25 lead from ${before} to ${percent()} %`)
  key("0")
  check(percent() == before, "0 does not fit")
  key("g")
  check(get("ellipses").checked && pixels("overlay").some(v => v > 0), "no ellipses")
  key("g")
  check(pixels("overlay").every(v => v == 0), "the ellipses stay")
  const drawn = new Promise(resolve => stage.addEventListener("drawn", resolve, { once: true }))
  stage.dispatchEvent(new page.WheelEvent("wheel", { deltaY: -480, cancelable: true }))
  check(percent() > 3.9 * before, "the wheel does not zoom")
  check(await Promise.race([drawn, new Promise(r => setTimeout(r, patience))]), "it is not drawn anew")

  const other = await open("/spec/vectors/invalid/checksum/file.ssplat")
  check(await until(() => /checksum/.test(other.document.getElementById("status").textContent)), "a broken file is not told")

  // The same page with a file in it, which asks for nothing else.
  const packed = await open("", "/web/dist/packed.html"), drew = () => packed.document.getElementById("picture").getContext("2d").getImageData(0, 0, 300, 150).data.some(v => v > 0)
  check(await until(() => packed.document.title == "file.ssplat" && drew()), `the packed page shows nothing: ${packed.document.getElementById("status").textContent}`)
  check(!packed.performance.getEntriesByType("resource").some(e => e.name.startsWith("http")), "the packed page asks for more")
  return { problems, words: `${checks} promises` }
}
