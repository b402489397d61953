// Tests <ssplat-img>.
import "/web/dist/ssplat-img.js"
import { decode, info } from "/web/dist/ssplat.js"
import { exif, profile, withSections } from "/web/test/sections.js"

const vector = name => `/spec/vectors/valid/${name}/file.ssplat`
const patience = 60_000

// Waits for the first of these events; returns "nothing" after this many milliseconds.
const event = (element, names, time = patience) => new Promise(resolve => {
  for (const name of names) element.addEventListener(name, resolve, { once: true })
  setTimeout(() => resolve({ type: "nothing" }), time)
})

const p3 = [[.5151, .2412, -.0011], [.292, .6922, .0419], [.1571, .0666, .7841]], srgb = [[.4361, .2225, .0139], [.3851, .7169, .0971], [.1431, .0606, .7141]]

export async function test() {
  const problems = []
  let checks = 0
  const check = (good, words) => {
    checks++
    if (!good) problems.push(words)
  }
  const add = (attributes, style = "") => {
    const element = document.createElement("ssplat-img")
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value)
    element.style = style
    document.body.append(element)
    return element
  }
  const canvas = element => element.shadowRoot.querySelector("canvas")
  const base64 = async path => btoa(String.fromCharCode(...new Uint8Array(await (await fetch(path)).arrayBuffer())))
  const seen = element => !canvas(element).hidden && canvas(element).getContext("2d").getImageData(0, 0, canvas(element).width, canvas(element).height).data.some(v => v > 0 && v < 255)

  // The element has the size of the picture, and fires `load` when it has loaded.
  const plain = add({ src: vector("coded-rgb"), alt: "a picture" })
  check((await event(plain, ["load", "error"])).type == "load", "no load event")
  const box = plain.getBoundingClientRect()
  check(plain.naturalWidth > 1 && box.width == plain.naturalWidth && box.height == plain.naturalHeight, `the size is ${box.width} x ${box.height}, not ${plain.naturalWidth} x ${plain.naturalHeight}`)
  check(seen(plain) && plain.complete && plain.role == "img" && plain.ariaLabel == "a picture", "nothing is seen")
  await plain.decode()

  // It renders at the resolution of the device, and again when the size changes.
  const small = add({ src: vector("coded-rgb"), width: 24 })
  await event(small, ["load", "error"])
  check(canvas(small).width == Math.ceil(24 * devicePixelRatio), `24 px are drawn as ${canvas(small).width}`)
  check(Math.abs(small.getBoundingClientRect().height - 24 * small.naturalHeight / small.naturalWidth) < 1, "the shape is not kept")
  small.setAttribute("width", 200)
  for (let i = 0; i < patience / 50 && canvas(small).width < 200; i++) await new Promise(r => setTimeout(r, 50))
  check(canvas(small).width == Math.ceil(200 * devicePixelRatio), `200 px are drawn as ${canvas(small).width}`)

  // A damaged or missing file causes an error with the reason, and does not affect other elements.
  for (const [src, kind] of [["/spec/vectors/invalid/empty-file/file.ssplat", "format"], ["/spec/vectors/invalid/checksum/file.ssplat", "format"], ["/spec/vectors/limits/many-primitives/file.ssplat", "limit"], ["/web/no-such-file.ssplat", "network"], ["http://127.0.0.1:1/refused.ssplat", "network"]]) {
    const broken = add({ src, alt: "what it would be" }), answer = await event(broken, ["load", "error"])
    check(answer.type == "error" && answer.error.kind == kind && answer.message.includes(src), `${src}: ${answer.type}, ${answer.error?.kind}`)
    check(broken.shadowRoot.querySelector("span").textContent == "what it would be" && !broken.shadowRoot.querySelector("span").hidden, `${src}: alt is not shown`)
    broken.src = vector("coded-rgb")
    check((await event(broken, ["load", "error"])).type == "load", `${src}: no other file can be shown after it`)
  }

  // The intact parts of a broken file are shown.
  const damaged = add({ src: "/spec/vectors/invalid/detail-check/file.ssplat" })
  check((await event(damaged, ["load", "error"])).type == "error" && seen(damaged) && !damaged.naturalWidth, "a broken file shows nothing")
  const broken = add({ src: "/web/README.md" }), { error } = await event(broken, ["load", "error"])
  check(/not a valid ssplat file: bad magic \[23, 20, 73, 73\]$/.test(error?.message), error?.message)

  // A placeholder is shown at once, as base64 and as data URI; broken ones are ignored.
  const inline = await base64(vector("coded-rgb"))
  for (const placeholder of [inline, `data:image/x-ssplat;base64,${inline}`]) {
    const held = add({ placeholder })
    check(seen(held) && held.getBoundingClientRect().width == plain.naturalWidth, "the placeholder is not seen")
  }
  // It is rendered finely when the page has time, unless the picture has replaced it.
  const large = add({ placeholder: inline, width: 300 }), replaced = add({ placeholder: inline, src: vector("coded-rgb"), width: 300 })
  check(canvas(large).width == 64, `a placeholder is first drawn ${canvas(large).width} wide`)
  await event(replaced, ["load", "error"])
  for (let i = 0; i < patience / 50 && canvas(large).width == 64; i++) await new Promise(r => setTimeout(r, 50))
  check(canvas(large).width == 192 && canvas(replaced).width == Math.ceil(300 * devicePixelRatio), `placeholders are drawn ${canvas(large).width} wide, pictures ${canvas(replaced).width}`)
  const unharmed = add({ placeholder: "AAAA", src: vector("coded-grey") })
  check((await event(unharmed, ["load", "error"])).type == "load", "a broken placeholder does harm")
  const kept = add({ placeholder: inline, src: "/web/no-such-file.ssplat" })
  await event(kept, ["load", "error"])
  check(seen(kept), "the placeholder is gone after an error")

  // Pictures of other formats are shown, too.
  const other = add({ src: "/tests/images/kodim15.png", placeholder: inline, width: 96 })
  check((await event(other, ["load", "error"])).type == "load" && other.naturalWidth > 96 && canvas(other).hidden, "a PNG is not shown")
  check(other.currentSrc == new URL("/tests/images/kodim15.png", location).href && add({}).currentSrc == "", `currentSrc is ${other.currentSrc}`)

  // The EXIF orientation is applied.
  const file = new Uint8Array(await (await fetch(vector("coded-rgb"))).arrayBuffer()), url = bytes => URL.createObjectURL(new Blob([bytes]))
  const pixels = (element, settings) => canvas(element).getContext("2d").getImageData(0, 0, canvas(element).width, canvas(element).height, settings).data
  const [w, h] = [plain.naturalWidth, plain.naturalHeight], stored = pixels(plain)
  const from = [, (x, y) => [x, y], (x, y) => [w - 1 - x, y], (x, y) => [w - 1 - x, h - 1 - y], (x, y) => [x, h - 1 - y], (x, y) => [y, x], (x, y) => [y, h - 1 - x], (x, y) => [w - 1 - y, h - 1 - x], (x, y) => [w - 1 - y, x]]
  for (let orientation = 1; orientation <= 8; orientation++) {
    const turned = add({ src: url(withSections(file, { exif: exif(orientation) })) })
    check((await event(turned, ["load", "error"])).type == "load", `orientation ${orientation} is an error`)
    const sides = orientation > 4 ? [h, w] : [w, h], now = pixels(turned)
    check(turned.naturalWidth == sides[0] && turned.naturalHeight == sides[1] && canvas(turned).width == sides[0] && canvas(turned).height == sides[1], `orientation ${orientation}: ${turned.naturalWidth} x ${turned.naturalHeight}`)
    check(now.every((v, i) => {
      const [x, y] = from[orientation]((i >> 2) % sides[0], Math.floor((i >> 2) / sides[0]))
      return v == stored[4 * (y * w + x) + (i & 3)]
    }), `orientation ${orientation}: pixels are elsewhere`)
  }

  // Samples are in the colour space of the profile.
  for (const [primaries, colorSpace] of [[p3, "display-p3"], [srgb, "srgb"]]) {
    const coloured = add({ src: url(withSections(file, { iccp: profile(primaries) })) })
    check((await event(coloured, ["load", "error"])).type == "load", `${colorSpace} is an error`)
    const space = canvas(coloured).getContext("2d").getContextAttributes().colorSpace
    check(space == colorSpace && pixels(coloured, { colorSpace }).every((v, i) => v == stored[i]), `a file in ${colorSpace} is drawn in ${space}`)
  }

  // Serves a file in pieces that end at these bytes; each `more()` sends the next one.
  const inPieces = async (name, ends) => {
    const bytes = new Uint8Array(await (await fetch(vector(name))).arrayBuffer()), fetches = window.fetch
    let stream, at = 0
    window.fetch = async () => new Response(new ReadableStream({ start: s => stream = s }))
    const element = add({ src: "/slow.ssplat" }), loaded = event(element, ["load", "error"])
    window.fetch = fetches
    const more = () => {
      const end = ends.shift()
      stream.enqueue(bytes.slice(at, end))
      if (end == undefined) stream.close()
      at = end
    }
    more()
    return { bytes, element, loaded, more, cut: () => stream.error(new Error("gone")) }
  }
  const until = async good => {
    for (let i = 0; i < patience / 50 && !good(); i++) await new Promise(r => setTimeout(r, 50))
    return good()
  }
  const same = (a, b) => a.length == b.length && a.every((v, i) => v == b[i])

  // The received part of a file with groups is shown before the rest has arrived.
  const streamed = await inPieces("groups-divided", [3000])
  check(await until(() => seen(streamed.element)) && !streamed.element.complete, "half of a file shows nothing")
  const half = pixels(streamed.element)
  streamed.more()
  check((await streamed.loaded).type == "load" && streamed.element.complete, "a file in two parts does not load")
  const once = add({ src: vector("groups-divided") })
  await event(once, ["load", "error"])
  check(same(pixels(once), pixels(streamed.element)) && !same(half, pixels(once)), "a file in two parts is not drawn whole")

  // What has arrived stays if the transfer breaks off, or if the file ends there, even if nothing was shown before.
  for (const [name, end] of [["groups-divided", 3000], ["detail-odd", -40]]) {
    const torn = await inPieces(name, [end]), expected = await decode(torn.bytes.slice(0, end), { partial: true })
    torn.cut()
    const { type, error } = await torn.loaded
    check(type == "error" && error.kind == "network" && seen(torn.element) && same(pixels(torn.element), expected.data), `${name}: what has arrived is not shown after an ${type}`)
    const cut = add({ src: url(torn.bytes.slice(0, end)) })
    check((await event(cut, ["load", "error"])).type == "error" && same(pixels(cut), expected.data), `${name}: a file that is cut off is not shown`)
  }

  // Its levels are shown as soon as they are complete, the coarse one first, even if only three bytes have arrived since the last rendering
  // and no more follow.
  const levels = await inPieces("groups-levels", [180, 183]), { levels: [coarse, finer], gaussians } = await info(levels.bytes)
  for (const [end, there] of [[180, coarse], [183, coarse + finer]]) {
    const expected = await decode(levels.bytes.slice(0, end), { partial: true })
    check(expected.missing == gaussians - there, `of ${end} bytes ${expected.missing} Gaussians are missing`)
    check(await until(() => seen(levels.element) && same(pixels(levels.element), expected.data)), `a level of ${there} Gaussians is not seen`)
    check(!levels.element.complete, "a level is the whole file")
    levels.more()
  }
  check((await levels.loaded).type == "load" && same(pixels(levels.element), (await decode(levels.bytes)).data), "a file with levels is not drawn whole")

  // The thumbnail of a file is shown first, at the size of the picture.
  const early = await inPieces("sections-thumbnail", [-8])
  check(await until(() => seen(early.element)) && !early.element.complete, "a thumbnail is not seen")
  const before = pixels(early.element)
  early.more()
  check((await early.loaded).type == "load" && pixels(early.element).length == before.length && !same(pixels(early.element), before), "the picture does not follow its thumbnail")

  // Elements far from the viewport wait until they are near.
  add({}, "display: block; height: 20000px")
  const lazy = add({ src: vector("coded-rgb"), loading: "lazy", width: 50 })
  check((await event(lazy, ["load", "error"], 500)).type == "nothing" && !lazy.complete, "lazy does not wait")
  lazy.scrollIntoView()
  check((await event(lazy, ["load", "error"])).type == "load", "lazy never loads")

  // This also holds for a long page in which only the widths are known.
  const many = Array.from({ length: 60 }, () => add({ src: vector("coded-rgb"), loading: "lazy", width: 300 }, "display: block"))
  many[0].scrollIntoView()
  await event(many[0], ["load", "error"])
  await new Promise(r => setTimeout(r, 500))
  const there = many.filter(m => m.complete).length
  check(there > 0 && there < 20, `${there} of 60 pictures are loaded at once`)

  // A removed element fires no events.
  const gone = add({ src: vector("coded-many") })
  gone.remove()
  check((await event(gone, ["load", "error"], 500)).type == "nothing", "a removed element says something")
  return { problems, words: `${checks} promises` }
}
