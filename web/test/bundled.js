// Tests a page that was built from web/examples: it shows the file, with a worker if the policy allows one.
const patience = 60_000
const until = async what => {
  for (let i = 0; i < patience / 50; i++) {
    if (what()) return true
    await new Promise(r => setTimeout(r, 50))
  }
  return false
}

export async function test(pages) {
  const problems = [], words = []
  for (const { name, url, known, blob, development } of pages) {
    const check = (good, what) => { if (!good) problems.push(`${name}: ${what}`) }
    await fetch("/asked")
    const frame = document.createElement("iframe")
    frame.src = url
    frame.style = "width: 900px; height: 900px"
    document.body.replaceChildren(frame)
    await new Promise(resolve => {
      frame.onload = resolve
      setTimeout(resolve, patience)
    })
    // Vite may reload the page after it has resolved the imports.
    const get = selector => frame.contentDocument?.querySelector(selector), told = () => frame.contentWindow.told ?? []
    check(await until(() => get("#part")?.width == 512 && get("ssplat-img")?.complete && get("ssplat-img").naturalWidth > 1), `nothing is shown: ${told().join("; ")}`)
    const seen = canvas => canvas?.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some(v => v > 0 && v < 255)
    check(seen(get("#part")) && seen(get("ssplat-img")?.shadowRoot?.querySelector("canvas")), "what is shown is empty")
    const asked = await (await fetch("/asked")).json(), wasm = asked.filter(path => /\.wasm/.test(path)), worker = asked.filter(path => /worker[^/]*\.js|\/\d+\.js/.test(path))
    if (!development) {
      check(known ? wasm.length == 1 || wasm.every(path => path == wasm[0]) && wasm.length : !wasm.length, `the WebAssembly was asked for as ${wasm}`)
      check(known == worker.length > 0, `the worker was asked for as ${worker} of ${asked}`)
      const alone = told().some(w => /no worker starts/.test(w))
      check(alone == !(known || blob), alone ? "no worker started" : "a worker started against the policy")
    }
    check(!told().some(w => !/no worker starts/.test(w)), told().join("; "))
    words.push(`${name}: ${wasm.length} wasm, ${worker.length} worker`)
  }
  return { problems, words: words.join("; ") }
}
