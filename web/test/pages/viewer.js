// Tests the viewer: it opens a file, zooms and pans, compares it, and reports the fault of a broken one.
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
  const zoom = () => parseFloat(get("zoom").textContent.replace(",", "")), frame = () => new Promise(r => page.requestAnimationFrame(() => page.requestAnimationFrame(r)))
  check(await until(() => pixels("picture").some(v => v > 0 && v < 255)), "nothing is drawn")
  check(/Where the bytes go/.test(get("panel").textContent) && get("panel").querySelectorAll("table").length >= 4, "no facts are told")
  check(get("panel").hidden && get("empty").hidden && get("message").hidden && !get("tools").hidden, "something lies over the picture")

  // Keys work at once, wherever the focus is; the question mark lists them.
  const key = (name, at = page.document.body) => at.dispatchEvent(new page.KeyboardEvent("keydown", { key: name, bubbles: true, cancelable: true }))
  key("1")
  check(get("zoom").textContent == "1×", `pixel for pixel is called ${get("zoom").textContent}`)
  for (let i = 0; i < 12; i++) key("+")
  check(/^1[45]×$/.test(get("zoom").textContent), `12 steps of 1.25 lead from 1× to ${get("zoom").textContent}`)
  check(await until(() => stage.dataset.drawn == "WebGL2"), `at ${get("zoom").textContent} the ${stage.dataset.drawn} draws`)
  key("?")
  check(get("help").open && get("help").querySelectorAll("tr").length > 10, "? shows no keys")
  key("1")
  check(get("zoom").textContent != "1×", "keys go through the help")
  get("help").close()
  key("i", get("out"))
  check(!get("panel").hidden && get("facts").ariaExpanded == "true", "I shows no facts")
  key("Escape")
  check(get("panel").hidden, "Escape leaves the facts")
  // The stage regains its size when the facts are closed.
  await frame()
  key("0")
  const before = zoom()
  check(before > 1, `fitted it is ${get("zoom").textContent}`)
  key("g")
  await frame()
  check(!get("tones").hidden && pixels("overlay").some(v => v > 0), "no ellipses")
  const own = pixels("overlay").join(), colours = () => page.document.querySelector("input[name=colours]:checked").value
  key("c")
  await frame()
  check(colours() == "bits" && pixels("overlay").join() != own, `C colours Gaussians by ${colours()}`)
  check(/few bits/.test(get("legend").textContent) && !get("legend").hidden, "what the colours mean is not told")
  key("c")
  await frame()
  check(colours() == "own" && pixels("overlay").join() == own && get("legend").hidden, "they do not have their own colours again")
  key("g")
  await frame()
  check(pixels("overlay").every(v => v == 0), "the ellipses stay")
  const drawn = new Promise(resolve => stage.addEventListener("drawn", resolve, { once: true }))
  stage.dispatchEvent(new page.WheelEvent("wheel", { deltaY: -480, clientX: 400, clientY: 300, cancelable: true }))
  check(zoom() > 3.8 * before, "the wheel does not zoom")
  check(await Promise.race([drawn, new Promise(r => setTimeout(r, patience))]), "it is not drawn anew")
  stage.dispatchEvent(new page.MouseEvent("dblclick", { clientX: 400, clientY: 300 }))
  check(zoom() == before, "a double click does not fit it")

  // However far the picture is moved, a part of it remains visible.
  for (let i = 0; i < 100; i++) key("ArrowRight")
  await frame()
  await frame()
  check(await until(() => pixels("picture").some(v => v > 0)), "the picture can be lost")

  // Spreading two fingers zooms around their centre; one finger moves the picture. Events of a script cannot be captured.
  stage.setPointerCapture = () => {}
  const touch = (type, pointerId, x, y) => {
    const { left, top } = stage.getBoundingClientRect()
    stage.dispatchEvent(new page.PointerEvent(type, { pointerId, pointerType: "touch", clientX: left + x, clientY: top + y, bubbles: true }))
  }
  key("1")
  touch("pointerdown", 1, 200, 200)
  touch("pointerdown", 2, 300, 200)
  touch("pointermove", 1, 150, 200)
  touch("pointermove", 2, 350, 200)
  for (const id of [1, 2]) touch("pointerup", id, 0, 0)
  check(Math.abs(zoom() - 2) < .06, `fingers twice as far apart lead from 1× to ${get("zoom").textContent}`)

  // All controls have labels for screen readers; colours follow the system's scheme.
  for (const element of page.document.querySelectorAll("input, button, a, #stage, aside, [role=slider]"))
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

  // Without a graphics device, the decoder renders the same.
  const cpu = await open("/spec/vectors/valid/coded-rgb/file.ssplat", undefined, "&draw=decoder"), picture = cpu.document.getElementById("picture")
  const drew = frame => frame.getContext("2d").getImageData(0, 0, frame.width, frame.height).data
  check(await until(() => drew(picture).some(v => v > 0 && v < 255)) && cpu.document.getElementById("stage").dataset.drawn == "decoder", "without WebGL2 nothing is drawn")

  // M marks what the exact layer covers: a part of one file, all of another. Files without the layer have no such control.
  check(cpu.document.getElementById("mask").hidden, "a file without an exact layer has a control for it")
  const share = async name => {
    const marked = await open(`/spec/vectors/valid/${name}/file.ssplat`), id = name => marked.document.getElementById(name)
    if (!await until(() => !id("mask").hidden)) return "there is no control for the exact layer"
    marked.document.body.dispatchEvent(new marked.KeyboardEvent("keydown", { key: "m", bubbles: true, cancelable: true }))
    await until(() => drew(id("overlay")).some(v => v > 0))
    // Relative to the box that the picture takes in the stage.
    const alpha = drew(id("overlay")).filter((_, k) => k % 4 == 3), [w, h] = [id("stage").clientWidth, id("stage").clientHeight]
    const rows = Array.from({ length: h }, (_, y) => alpha.slice(y * w, (y + 1) * w)).filter(row => row.some(v => v > 0))
    return alpha.filter(v => v > 0).length / (rows.length * Math.max(...rows.map(row => row.lastIndexOf(Math.max(...row)) - row.findIndex(v => v > 0) + 1)))
  }
  const all = await share("exact-rgb-8"), some = await share("exact-mask")
  // Its edges may share pixels of the screen with the ground.
  check(Math.abs(all - 1) < .03, `of a file that is exact, ${all} is marked`)
  check(some > .05 && some < .95, `of a file with a mask, ${some} is marked`)

  // The original is shown behind a border that keys and a handle move, or alone.
  const compared = await open("/spec/vectors/valid/coded-rgb/file.ssplat", undefined, "&original=/tests/images/kodim05.png"), $ = id => compared.document.getElementById(id)
  check(await until(() => !$("comparing").hidden), `an original is not shown: ${$("status").textContent}`)
  const settled = () => new Promise(r => compared.requestAnimationFrame(() => compared.requestAnimationFrame(r)))
  const press = name => compared.document.body.dispatchEvent(new compared.KeyboardEvent("keydown", { key: name, bubbles: true, cancelable: true }))
  const at = part => drew($("picture")).slice(4 * ($("picture").width * ($("picture").height >> 1) + Math.floor($("picture").width * part)), 4 * ($("picture").width * ($("picture").height >> 1) + Math.floor($("picture").width * part)) + 400).join()
  const side = async value => {
    const choice = compared.document.querySelector(`input[name=sides][value=${value}]`)
    choice.click()
    await settled()
    return [at(.3), at(.6)]
  }
  const ours = await side("file")
  check($("border").hidden, "there is a border in one picture")
  const theirs = await side("original")
  check(ours[0] != theirs[0] && ours[1] != theirs[1], "the original is the file")
  const both = await side("both")
  check(both[0] == ours[0] && both[1] == theirs[1] && !$("border").hidden && $("border").style.left == "50%", "they are not side by side")
  for (let i = 0; i < 5; i++) press("[")
  await settled()
  check($("border").ariaValueNow == "25" && at(.3) == theirs[0], `the border is at ${$("border").ariaValueNow} % after five steps`)
  const { left, width } = $("stage").getBoundingClientRect()
  $("border").dispatchEvent(new compared.PointerEvent("pointermove", { buttons: 1, clientX: left + .8 * width }))
  await settled()
  check($("border").ariaValueNow == "80" && at(.6) == ours[1], `the border is at ${$("border").ariaValueNow} % after it was drawn to 80 %`)
  press("x")
  await settled()
  check(at(.3) == theirs[0], "X does not show the original")
  press("x")
  check(await until(() => !compared.document.querySelector("input[name=colours][value=error]").disabled), "no errors to colour Gaussians by")
  press("g")
  await settled()
  const plain = drew($("overlay")).join()
  compared.document.querySelector("input[name=colours][value=error]").click()
  await settled()
  check(drew($("overlay")).join() != plain, "the error colours no Gaussian")

  // Files that cannot be shown cause a message with their first bytes; then another file can be opened.
  for (const [url, words] of [["/spec/vectors/invalid/checksum/file.ssplat", /broken.*checksum.*89 53 53 50/s], ["/spec/ssplat.md", /neither a picture nor an \.ssplat file.*of an unknown kind.*begins with 23 20/s], ["/web/nowhere.ssplat", /nowhere.ssplat was not found.*404/s]]) {
    const other = await open(url), message = other.document.getElementById("message")
    check(await until(() => !message.hidden && words.test(message.textContent)), `${url}: ${message.textContent}`)
    other.document.getElementById("dismiss").click()
    check(message.hidden && !other.document.getElementById("empty").hidden, `${url}: closing it does not lead to the start`)
  }

  // Without a file, the page explains the format and offers three samples.
  const empty = await open(""), cards = () => empty.document.querySelectorAll(".sample")
  check(await until(() => cards().length == 3), `${cards().length} pictures to try`)
  check(!empty.document.getElementById("empty").hidden && /Gaussians/.test(empty.document.getElementById("empty").textContent), "the page does not say what it is")
  cards()[1]?.click()
  check(await until(() => empty.document.title == "motocross.ssplat" && empty.document.getElementById("empty").hidden), "a picture to try is not shown")

  // On a phone, nothing is wider than the screen, controls are large enough for touch, and the facts are a sheet below the picture.
  const phone = await open("/spec/vectors/valid/coded-rgb/file.ssplat", undefined, "&original=/tests/images/kodim05.png"), the = id => phone.document.getElementById(id)
  phone.frameElement.style = "width: 390px; height: 844px; border: 0"
  check(await until(() => !the("tools").hidden && !the("comparing").hidden && phone.innerWidth == 390), "a phone shows nothing")
  the("ellipses").click()
  the("facts").click()
  await new Promise(r => phone.requestAnimationFrame(() => phone.requestAnimationFrame(r)))
  for (const element of phone.document.querySelectorAll("button, .pill, .choices label, #panel, #stage")) {
    const { left, right, width, height } = element.getBoundingClientRect()
    if (width && element.checkVisibility()) check(left >= 0 && right <= 390.5, `#${element.id} ${element.className} reaches from ${left} to ${right}`)
    if (height && element.matches("header button, .pill button, .choices label")) check(Math.min(width, height) >= 44, `#${element.id}: ${width} × ${height} is small for a finger`)
  }
  const sheet = the("panel").getBoundingClientRect(), seen = the("stage").getBoundingClientRect()
  check(sheet.top >= seen.bottom - 1 && sheet.bottom <= 844.5 && seen.height > 250, `the sheet is at ${sheet.top}, the picture ends at ${seen.bottom}`)
  the("grip").click()
  check(the("panel").hidden, "the sheet cannot be closed")

  // The same page with an embedded file, which sends no requests.
  const packed = await open("", "/web/dist/packed.html"), packedDrew = () => drew(packed.document.getElementById("picture")).some(v => v > 0)
  check(await until(() => packed.document.title == "file.ssplat" && packedDrew()), `the packed page shows nothing: ${packed.document.getElementById("status").textContent}`)
  check(!packed.performance.getEntriesByType("resource").some(e => e.name.startsWith("http")), "the packed page asks for more")
  const pair = await open("", "/web/dist/packed-original.html")
  check(await until(() => !pair.document.getElementById("comparing").hidden), "the packed page has no original")
  return { problems, words: `${checks} promises` }
}
