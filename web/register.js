// Installs service-worker.js, which lets <img>, srcset, <picture> and CSS show .ssplat files. It imports nothing, so that the worker starts early.

const simd = () => new URL("./ssplat-simd.wasm", import.meta.url), scalar = () => new URL("./ssplat-scalar.wasm", import.meta.url)
const vectors = Uint8Array.of(0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11)

// The URL of the WebAssembly. As in source.js, a bundle where it was not rewritten has none; then it lies beside the script of the worker.
function moduleUrl() {
  const here = import.meta.url
  if (!/\/register\.js(\?.*)?$/.test(here) && simd().href == new URL("ssplat-simd.wasm", here).href) return ""
  return (WebAssembly.validate(vectors) ? simd() : scalar()).href
}

// Vite replaces BASE_URL by the `base` of its configuration.
const defaultUrl = () => `${import.meta.env?.BASE_URL ?? "/"}ssplat-service-worker.js`

const isSsplat = url => /\.ssplat(?=$|[\s?#"'),])/.test(url)

// Makes the browser load again what an attribute names. Firefox ignores some attributes that are set to their own value.
function reset(element, name) {
  const value = element.getAttribute(name)
  element.removeAttribute(name)
  element.setAttribute(name, value)
}

// Makes the browser load what it could not show.
function retry(element) {
  for (const name of ["src", "srcset", "href", "poster"]) if (isSsplat(element.getAttribute(name) ?? "")) reset(element, name)
}

// The same for style rules, and for elements with a style.
function retryStyles(rules) {
  for (const { style, cssRules } of rules) {
    for (const name of [...style ?? []]) {
      const value = style.getPropertyValue(name), priority = style.getPropertyPriority(name)
      if (!isSsplat(value)) continue
      style.removeProperty(name)
      style.setProperty(name, value, priority)
    }
    if (cssRules) retryStyles(cssRules)
  }
}

// Loads all pictures of the page again that failed before the worker answered.
function retryAll() {
  for (const img of document.images) {
    if (!isSsplat(img.currentSrc || `${img.src} ${img.srcset}`) || img.complete && img.naturalWidth) continue
    // Within <picture>, its own attributes may name another file.
    for (const name of ["src", "srcset"]) if (img.hasAttribute(name)) reset(img, name)
  }
  document.querySelectorAll("input[type=image], image, video[poster]").forEach(retry)
  retryStyles(document.querySelectorAll("[style*='.ssplat']"))
  retrySheets()
}

// The same for the style sheets of the page.
function retrySheets() {
  for (const sheet of [...document.styleSheets, ...document.adoptedStyleSheets ?? []])
    try {
      retryStyles(sheet.cssRules)
    } catch {
      // A style sheet of another origin cannot be read.
    }
}

// Installs the worker at `url`, by default /ssplat-service-worker.js, for the pages below `scope`; or uses the `registration` of another service
// worker that imports it. Returns whether it answers the requests of this page. Browsers have no service workers in pages without HTTPS.
export async function registerSsplat({ url = defaultUrl(), scope, module = moduleUrl(), registration } = {}) {
  const container = globalThis.navigator?.serviceWorker
  if (!container) return false
  if (!registration) {
    const script = new URL(url, document.baseURI)
    script.searchParams.set("ssplat", module)
    registration = container.register(script, { scope })
  }
  const controlled = new Promise(resolve => container.addEventListener("controllerchange", resolve, { once: true }))
  const wasControlled = container.controller, { active, waiting, installing, scope: pages } = await registration
  if (wasControlled) {
    // Firefox keeps the failures of a style sheet for later pages with the same one.
    if (CSS.supports("-moz-appearance: none")) retrySheets()
    return true
  }
  const worker = active ?? waiting ?? installing
  await new Promise(resolve => {
    const look = () => { if (["activating", "activated", "redundant"].includes(worker.state)) resolve() }
    worker.addEventListener("statechange", look)
    look()
  })
  if (worker.state == "redundant" || !location.href.startsWith(pages)) return false
  worker.postMessage("ssplat: claim")
  await controlled
  retryAll()
  return true
}
