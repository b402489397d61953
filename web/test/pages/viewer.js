// What the viewer promises: it opens a file, zooms and pans, compares it, and says what is wrong with a broken one.
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
  const open = async (file, page = "/web/dist/viewer/index.html", more = "") => {
    const frame = document.createElement("iframe")
    frame.src = file ? `${page}?file=${file}${more}` : page
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
  check(await until(() => stage.dataset.drawn == "WebGL2"), `at ${percent()} % the ${stage.dataset.drawn} draws`)
  key("0")
  check(percent() == before, "0 does not fit")
  key("g")
  check(get("ellipses").checked && pixels("overlay").some(v => v > 0), "no ellipses")
  const own = pixels("overlay").join()
  key("c")
  check(get("colours").value == "bits" && pixels("overlay").join() != own, `C colours Gaussians by ${get("colours").value}`)
  check(/red ones many/.test(get("status").textContent), "what the colours mean is not told")
  key("c")
  check(get("colours").value == "own" && pixels("overlay").join() == own, "they do not have their own colours again")
  key("g")
  check(pixels("overlay").every(v => v == 0), "the ellipses stay")
  const drawn = new Promise(resolve => stage.addEventListener("drawn", resolve, { once: true }))
  stage.dispatchEvent(new page.WheelEvent("wheel", { deltaY: -480, cancelable: true }))
  check(percent() > 3.9 * before, "the wheel does not zoom")
  check(await Promise.race([drawn, new Promise(r => setTimeout(r, patience))]), "it is not drawn anew")

  // Two fingers that go apart zoom as much, about their middle; one moves. Events of a script cannot be captured.
  stage.setPointerCapture = () => {}
  const touch = (type, pointerId, x, y) => {
    const { left, top } = stage.getBoundingClientRect()
    stage.dispatchEvent(new page.PointerEvent(type, { pointerId, pointerType: "touch", clientX: left + x, clientY: top + y, bubbles: true }))
  }
  key("0")
  touch("pointerdown", 1, 200, 200)
  touch("pointerdown", 2, 300, 200)
  touch("pointermove", 1, 150, 200)
  touch("pointermove", 2, 350, 200)
  for (const id of [1, 2]) touch("pointerup", id, 0, 0)
  check(Math.abs(percent() / before - 2) < .01, `fingers twice as far apart lead from ${before} to ${percent()} %`)

  // Whoever does not see the page is told what everything on it is; colours follow the system's.
  for (const element of page.document.querySelectorAll("input, button, select, main, aside"))
    check(element.ariaLabel || element.labels?.[0]?.textContent.trim() || element.textContent.trim(), `#${element.id} has no name`)
  check(get("status").getAttribute("aria-live") == "polite", "changes are not read aloud")
  check(page.getComputedStyle(page.document.documentElement).colorScheme == "light dark", "there is no dark mode")
  const light = v => v.match(/\d+/g).slice(0, 3).reduce((sum, v) => sum + Number(v), 0) / 3
  for (const [scheme, dark] of [["dark", true], ["light", false]]) {
    page.document.documentElement.style.colorScheme = scheme
    const { backgroundColor, color } = page.getComputedStyle(page.document.body)
    check(light(backgroundColor) < 64 == dark && light(color) > 192 == dark, `${scheme}: ${color} on ${backgroundColor}`)
  }
  page.document.documentElement.style.colorScheme = ""

  // The decoder draws the same where there is no graphics device.
  const cpu = await open("/spec/vectors/valid/coded-rgb/file.ssplat", undefined, "&draw=decoder"), picture = cpu.document.getElementById("picture")
  const drew = frame => frame.getContext("2d").getImageData(0, 0, frame.width, frame.height).data
  check(await until(() => drew(picture).some(v => v > 0 && v < 255)) && cpu.document.getElementById("stage").dataset.drawn == "decoder", "without WebGL2 nothing is drawn")

  // An original lies behind a border that keys and a slider move.
  const compared = await open("/spec/vectors/valid/coded-rgb/file.ssplat", undefined, "&original=/tests/images/kodim05.png"), $ = id => compared.document.getElementById(id)
  check(await until(() => !$("comparing").hidden), `an original is not shown: ${$("status").textContent}`)
  const at = x => drew($("picture")).slice(4 * ($("picture").width * ($("picture").height >> 1) + x), 4 * ($("picture").width * ($("picture").height >> 1) + x + 4)).join()
  const far = $("picture").width * 3 >> 2
  $("split").value = 100
  $("split").dispatchEvent(new compared.Event("input"))
  await until(() => at(far) != at(far + 8))
  await new Promise(r => compared.requestAnimationFrame(() => compared.requestAnimationFrame(r)))
  const whole = at(far)
  for (let i = 0; i < 10; i++) $("stage").dispatchEvent(new compared.KeyboardEvent("keydown", { key: "[" }))
  check($("split").value == 50, `the border is at ${$("split").value} % after ten steps`)
  check(await until(() => at(far) != whole), "behind the border is no original")
  check(await until(() => !$("colours").querySelector("[value=error]").disabled), "no errors to colour Gaussians by")
  $("ellipses").checked = true
  $("colours").value = "own"
  $("colours").onchange()
  const colours = drew($("overlay")).join()
  $("colours").value = "error"
  check(await until(() => ($("colours").onchange(), drew($("overlay")).join() != colours)), "the error colours no Gaussian")

  const other = await open("/spec/vectors/invalid/checksum/file.ssplat")
  check(await until(() => /checksum/.test(other.document.getElementById("status").textContent)), "a broken file is not told")

  // The same page with a file in it, which asks for nothing else.
  const packed = await open("", "/web/dist/packed.html"), packedDrew = () => packed.document.getElementById("picture").getContext("2d").getImageData(0, 0, 300, 150).data.some(v => v > 0)
  check(await until(() => packed.document.title == "file.ssplat" && packedDrew()), `the packed page shows nothing: ${packed.document.getElementById("status").textContent}`)
  check(!packed.performance.getEntriesByType("resource").some(e => e.name.startsWith("http")), "the packed page asks for more")
  const both = await open("", "/web/dist/packed-original.html")
  check(await until(() => !both.document.getElementById("comparing").hidden), "the packed page has no original")
  return { problems, words: `${checks} promises` }
}
