// Measures how much a page moves while its pictures load: the sum of the browser's layout shifts.
const patience = 60_000

// The page of `ssplat placeholder --format html`, whose module loads late; `of` may change the element's text.
async function shifts(of = text => text) {
  const element = of((await (await fetch("/web/dist/placeholder.html")).text()).trim())
  const text = "<p>Words that are read meanwhile, of which there are enough for some lines, so that it is seen when they move.</p>"
  const frame = document.createElement("iframe")
  frame.style = "width: 900px; height: 700px; border: 0"
  frame.srcdoc = `<!doctype html><body>${text}${element}${text.repeat(3)}${element}${text}`
  document.body.replaceChildren(frame)
  await new Promise(resolve => frame.onload = resolve)
  const page = frame.contentWindow
  let sum = 0
  new page.PerformanceObserver(list => list.getEntries().forEach(entry => sum += entry.value)).observe({ type: "layout-shift", buffered: true })
  const pause = time => new Promise(r => setTimeout(r, time))
  await pause(500)
  const script = page.document.createElement("script")
  Object.assign(script, { type: "module", src: "/web/dist/ssplat-img.js" })
  page.document.body.append(script)
  const loaded = () => [...page.document.querySelectorAll("ssplat-img")].every(e => e.complete && e.naturalWidth > 1)
  for (let i = 0; i < patience / 50 && !loaded(); i++) await pause(50)
  await pause(500)
  return loaded() ? sum : NaN
}

export async function test() {
  const problems = [], still = await shifts(), bare = await shifts(text => text.replace(/ style="[^"]*"/, ""))
  // The authors of the measure consider 0.1 good.
  if (!(still < .02)) problems.push(`layout shifts are ${still}`)
  if (!(bare > .02)) problems.push(`without the style they are ${bare}, so nothing is measured here`)
  return { problems, words: `layout shifts ${still.toFixed(3)}, without the style ${bare.toFixed(3)}` }
}
