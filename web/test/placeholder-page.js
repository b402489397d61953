// Tests a page that imports pictures: it shows placeholders until the files have arrived, then the pictures, also in <img>. On the first visit
// the service worker has to be installed; on the next one it answers from the start.
const patience = 60_000
const until = async what => {
  for (let i = 0; i < patience / 50; i++) {
    if (what()) return true
    await new Promise(r => setTimeout(r, 50))
  }
  return false
}

export async function test(pages) {
  const problems = []
  for (const { name, url, sizes, images = 0 } of pages) {
    const check = (good, what) => { if (!good) problems.push(`${name}: ${what}`) }
    await fetch("/hold")
    const frame = document.createElement("iframe")
    frame.src = url
    frame.style = "width: 900px; height: 900px"
    document.body.replaceChildren(frame)
    const elements = () => [...frame.contentDocument?.querySelectorAll("ssplat-img") ?? []]
    const canvas = element => element.shadowRoot?.querySelector("canvas")
    const seen = element => {
      const { width, height, hidden } = canvas(element) ?? { hidden: true }
      return !hidden && width > 1 && canvas(element).getContext("2d").getImageData(0, 0, width, height).data.some(v => v > 0 && v < 255)
    }
    check(await until(() => elements().length == sizes.length && elements().every(seen)), `no placeholder is seen in ${elements().length} elements`)
    check(elements().every(element => !element.complete && !element.naturalWidth && canvas(element).width <= 96), "files came before they were let go, or placeholders are not drawn as such")
    const places = elements().map(element => element.getBoundingClientRect())
    await fetch("/release")
    check(await until(() => elements().every(element => element.complete)), "the files do not come")
    check(JSON.stringify(elements().map(element => [element.naturalWidth, element.naturalHeight])) == JSON.stringify(sizes), `the pictures have ${elements().map(e => `${e.naturalWidth} × ${e.naturalHeight}`)}`)
    check(elements().every(seen) && elements().every(element => canvas(element).width == 96), "the pictures are not seen")
    check(elements().every((element, i) => { const { width, height } = element.getBoundingClientRect(); return width == places[i].width && height == places[i].height }), "the pictures have other places than their placeholders")
    const shown = () => [...frame.contentDocument.images].filter(img => img.naturalWidth == 96).length
    check(await until(() => shown() == images), `${shown()} of ${images} pictures are seen in <img>`)
    const { contentDocument: first } = frame
    frame.contentWindow.location.reload()
    check(await until(() => frame.contentDocument != first && frame.contentDocument?.images.length == images && shown() == images), `next visit: ${shown()} of ${images} pictures are seen in <img>`)
    check(!images || frame.contentWindow.navigator.serviceWorker.controller, "next visit: the service worker does not answer")
    check(await until(() => elements().length == sizes.length && elements().every(element => element.complete)), "next visit: the files do not come")
  }
  return { problems, words: `${pages.map(page => page.name).join(", ")}: placeholders, then pictures; <img> on the first and the next visit` }
}
