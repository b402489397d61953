// The packed package with bundlers, without one, and in Node.js: node web/test/bundlers.mjs [FILE]
// web/dist becomes a tarball, web/examples are installed with it and built by each bundler, and Chromium opens what comes out under a strict policy.
// FILE is what is shown. With SSPLAT_REQUIRE_BROWSER=1 a missing Chromium is a failure, otherwise the browser is named as skipped.
import { spawn } from "node:child_process"
import { cpSync, mkdtempSync, readFileSync, readdirSync, rmSync } from "node:fs"
import { tmpdir } from "node:os"
import { join } from "node:path"
import { inChromium, typeOf } from "./chromium.mjs"
import { freePort, install, npm, pack } from "./packed.js"

const root = new URL("../../", import.meta.url)
const file = process.argv[2] ?? new URL("web/viewer/samples/motocross.ssplat", root).pathname
const home = mkdtempSync(join(tmpdir(), "ssplat-bundlers-"))
let failed = false
const check = (good, words) => {
  if (good) return
  console.log(`FAILED: ${words}`)
  failed = true
}
// Returns the output of a command. A warning about the package is a failure.
const command = (...words) => npm(home, ...words).catch(error => {
  check(false, error.message)
  return ""
})

// The policy of the page. Without `blob:`, no worker starts that the bundler does not handle; the page's thread decodes in this case.
const policy = workers => `default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src ${workers}; connect-src 'self'; style-src 'self'; img-src 'self'`
const builders = ["vite", "webpack", "esbuild", "rollup"]

let vite
try {
  cpSync(new URL("web/examples/", root), home, { recursive: true, filter: path => !/node_modules|\/out(\/|$)|examples\/(vite|webpack|next)(\/|$)/.test(path) })
  cpSync(file, join(home, "photo.ssplat"))
  const { filename, files, size } = await pack(home)
  console.log(`${filename}: ${size} bytes, ${files.length} files`)
  check(!files.some(f => /\.(webp|png)$/.test(f.path)), "pictures are in the package")
  await install(home, join(home, filename)).catch(error => check(false, error.message))

  check(/768 × 512 pixels/.test(await command("run", "node")), "Node.js decodes nothing")
  await command("run", "types")
  for (const name of builders) {
    const said = await command("run", `build:${name}`)
    // By default, webpack warns about files above 244 KiB, such as the WebAssembly.
    check(!/warn/i.test(said.replace(/WARNING in (asset|entrypoint) size limit|compiled with 1 warning|^1 warning has.*/gm, "")), `${name} warns: ${said}`)
    for (const page of name == "vite" ? ["photo.ssplat"] : ["photo.ssplat", "index.html"]) cpSync(join(home, page), join(home, "out", name, page))
  }

  // Vite's development server, below the folder that the test's server forwards to it.
  const port = await freePort()
  vite = spawn(join(home, "node_modules/.bin/vite"), ["--base", "/dev/", "--host", "127.0.0.1", "--port", String(port), "--strictPort"], { cwd: home, stdio: "ignore", detached: true })
  for (let i = 0; i < 200 && !(await fetch(`http://127.0.0.1:${port}/dev/`).catch(() => {})); i++) await new Promise(r => setTimeout(r, 100))

  const asked = []
  const hook = `window.told = []; for (const kind of ["warn", "error"]) console[kind] = (...words) => told.push(words.join(" ")); onerror = words => told.push(words)`
  const serve = async url => {
    const { pathname, searchParams } = new URL(url, "http://localhost"), [, from, ...rest] = pathname.split("/")
    if (pathname == "/hook.js") return { body: hook }
    if (pathname == "/asked") return { body: JSON.stringify(asked.splice(0)) }
    if (from == "dev") {
      const answer = await fetch(`http://127.0.0.1:${port}${url}`)
      asked.push(`${pathname}: ${answer.status}`)
      return { body: Buffer.from(await answer.arrayBuffer()), headers: { "content-type": answer.headers.get("content-type") ?? "" } }
    }
    const folder = { plain: home }[from] ?? (builders.includes(from) ? join(home, "out", from) : undefined)
    if (!folder) return
    asked.push(pathname)
    const name = rest.join("/"), body = readFileSync(join(folder, name))
    const headers = { "content-type": typeOf(name), "content-security-policy": policy(searchParams.get("workers") ?? "'self'") }
    return { body: name.endsWith(".html") ? body.toString().replace("<title>", `<script src="/hook.js"></script><title>`) : body, headers }
  }
  const pages = [
    ...builders.flatMap(name => ["'self'", "'self' blob:"].map(workers => ({ name: `${name}, workers ${workers}`, url: `/${name}/index.html?workers=${encodeURIComponent(workers)}`, known: /vite|webpack/.test(name), blob: /blob/.test(workers) }))),
    { name: "no bundler", url: "/plain/plain.html", known: true },
    { name: "vite, development", url: "/dev/index.html", development: true },
  ]
  const answer = await inChromium(root, "/web/test/bundled.js", pages, { serve })
  if (answer) {
    answer.problems.forEach(problem => check(false, problem))
    console.log(`Chromium: ${answer.words}`)
  } else if (process.env.SSPLAT_REQUIRE_BROWSER == "1") check(false, "Chromium is not installed")
  else console.log("Chromium: skipped, it is not installed")
  for (const name of builders) console.log(`${name}: ${readdirSync(join(home, "out", name), { recursive: true }).join(", ")}`)
} finally {
  if (vite) process.kill(-vite.pid, "SIGKILL")
  rmSync(home, { recursive: true, force: true, maxRetries: 20, retryDelay: 250 })
}
process.exit(failed ? 1 : 0)
