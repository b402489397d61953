// Measures when the placeholders of a page are visible, in milliseconds from the start of loading.
const elements = 100, loads = 10

export async function test(files) {
  const texts = Array.from({ length: elements }, (_, k) => files[k % files.length][1])
  const html = `<!doctype html><meta charset="utf-8"><script type="module" src="/web/dist/ssplat-img.js"></script>
<style>body { margin: 0 } ssplat-img { width: 90px; height: 60px }</style>${texts.map(t => `<ssplat-img placeholder="${t}"></ssplat-img>`).join("\n")}`
  const all = []
  for (let i = 0; i < loads; i++) {
    const frame = document.createElement("iframe")
    frame.style = "width: 950px; height: 750px; border: 0"
    frame.srcdoc = html
    document.body.replaceChildren(frame)
    await new Promise(resolve => frame.onload = resolve)
    const page = frame.contentWindow, shown = () => [...page.document.querySelectorAll("ssplat-img")].every(e => e.shadowRoot && !e.shadowRoot.querySelector("canvas").hidden)
    while (!shown()) await new Promise(r => page.requestAnimationFrame(r))
    await new Promise(r => page.requestAnimationFrame(() => page.requestAnimationFrame(r)))
    const drawn = page.performance.now()
    const script = page.performance.getEntriesByType("resource").reduce((last, e) => Math.max(last, e.responseEnd), 0)
    all.push([script, drawn])
  }
  const least = k => Math.min(...all.map(v => v[k])).toFixed(0), middle = k => all.map(v => v[k]).sort((a, b) => a - b)[loads >> 1].toFixed(0)
  return { lines: ["the page's modules are there", `all ${elements} placeholders are painted`].map((what, k) => `${what} after ${least(k)} ms at the least, ${middle(k)} in the middle`) }
}
