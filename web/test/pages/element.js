// What <ssplat-img> promises.
import "/web/dist/ssplat-img.js"

const vector = name => `/spec/vectors/valid/${name}/file.ssplat`
const patience = 60_000

// The first of these events; "nothing" after so many milliseconds.
const event = (element, names, time = patience) => new Promise(resolve => {
  for (const name of names) element.addEventListener(name, resolve, { once: true })
  setTimeout(() => resolve({ type: "nothing" }), time)
})

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

  // It has the size of the picture, and says so once it is there.
  const plain = add({ src: vector("coded-rgb"), alt: "a picture" })
  check((await event(plain, ["load", "error"])).type == "load", "no load event")
  const box = plain.getBoundingClientRect()
  check(plain.naturalWidth > 1 && box.width == plain.naturalWidth && box.height == plain.naturalHeight, `the size is ${box.width} x ${box.height}, not ${plain.naturalWidth} x ${plain.naturalHeight}`)
  check(seen(plain) && plain.complete && plain.role == "img" && plain.ariaLabel == "a picture", "nothing is seen")
  await plain.decode()

  // It is drawn at the device's pixels, again when the size changes.
  const small = add({ src: vector("coded-rgb"), width: 24 })
  await event(small, ["load", "error"])
  check(canvas(small).width == Math.ceil(24 * devicePixelRatio), `24 px are drawn as ${canvas(small).width}`)
  check(Math.abs(small.getBoundingClientRect().height - 24 * small.naturalHeight / small.naturalWidth) < 1, "the shape is not kept")
  small.setAttribute("width", 200)
  for (let i = 0; i < patience / 50 && canvas(small).width < 200; i++) await new Promise(r => setTimeout(r, 50))
  check(canvas(small).width == Math.ceil(200 * devicePixelRatio), `200 px are drawn as ${canvas(small).width}`)

  // A broken or missing file is an error with the reason, and hurts nothing else.
  for (const [src, kind] of [["/spec/vectors/invalid/checksum/file.ssplat", "format"], ["/spec/vectors/limits/many-primitives/file.ssplat", "limit"], ["/web/no-such-file.ssplat", undefined]]) {
    const broken = add({ src, alt: "what it would be" }), answer = await event(broken, ["load", "error"])
    check(answer.type == "error" && answer.error.kind == kind && answer.message.includes(src), `${src}: ${answer.type}, ${answer.error?.kind}`)
    check(broken.shadowRoot.querySelector("span").textContent == "what it would be" && !broken.shadowRoot.querySelector("span").hidden, `${src}: alt is not shown`)
    broken.src = vector("coded-rgb")
    check((await event(broken, ["load", "error"])).type == "load", `${src}: no other file can be shown after it`)
  }

  // A placeholder is there at once, as base64 and as data URI, and broken ones do no harm.
  const inline = await base64(vector("coded-rgb"))
  for (const placeholder of [inline, `data:image/x-ssplat;base64,${inline}`]) {
    const held = add({ placeholder })
    check(seen(held) && held.getBoundingClientRect().width == plain.naturalWidth, "the placeholder is not seen")
  }
  const unharmed = add({ placeholder: "AAAA", src: vector("coded-grey") })
  check((await event(unharmed, ["load", "error"])).type == "load", "a broken placeholder does harm")
  const kept = add({ placeholder: inline, src: "/web/no-such-file.ssplat" })
  await event(kept, ["load", "error"])
  check(seen(kept), "the placeholder is gone after an error")

  // Pictures of other formats are shown, too.
  const other = add({ src: "/tests/images/kodim15.png", placeholder: inline, width: 96 })
  check((await event(other, ["load", "error"])).type == "load" && other.naturalWidth > 96 && canvas(other).hidden, "a PNG is not shown")

  // What is far away waits until it is near.
  add({}, "display: block; height: 20000px")
  const lazy = add({ src: vector("coded-rgb"), loading: "lazy", width: 50 })
  check((await event(lazy, ["load", "error"], 500)).type == "nothing" && !lazy.complete, "lazy does not wait")
  lazy.scrollIntoView()
  check((await event(lazy, ["load", "error"])).type == "load", "lazy never loads")

  // A removed element says nothing.
  const gone = add({ src: vector("coded-many") })
  gone.remove()
  check((await event(gone, ["load", "error"], 500)).type == "nothing", "a removed element says something")
  return { problems, words: `${checks} promises` }
}
