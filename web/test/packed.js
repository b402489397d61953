// Packs web/dist as a tarball and installs it as users do.
import { execFile } from "node:child_process"
import { readFileSync, writeFileSync } from "node:fs"
import { createServer } from "node:net"
import { join } from "node:path"
import { promisify } from "node:util"

const run = promisify(execFile), dist = new URL("../dist/", import.meta.url).pathname

// Packs web/dist into `home`. Returns { filename, files, size }.
export async function pack(home) {
  const packed = JSON.parse((await run("npm", ["pack", "--json", "--pack-destination", home], { cwd: dist })).stdout)
  return Array.isArray(packed) ? packed[0] : Object.values(packed)[0]
}

// Runs `npm` in `folder` and returns its output; fails with the output.
export async function npm(folder, ...words) {
  try {
    const { stdout, stderr } = await run("npm", words, { cwd: folder, maxBuffer: 1 << 26, env: { ...process.env, NO_COLOR: "1", NEXT_TELEMETRY_DISABLED: "1" } })
    return stdout + stderr
  } catch (error) {
    throw new Error(`npm ${words.join(" ")}: ${error.stdout}${error.stderr}`)
  }
}

// Installs the dependencies of package.json in `folder`, with ssplat from `tarball`.
export async function install(folder, tarball) {
  const path = join(folder, "package.json"), wanted = JSON.parse(readFileSync(path))
  wanted.dependencies.ssplat = `file:${tarball}`
  writeFileSync(path, JSON.stringify(wanted))
  return npm(folder, "install", "--no-audit", "--no-fund", "--no-package-lock")
}

export const freePort = () => new Promise(resolve => {
  const probe = createServer().listen(0, "127.0.0.1", () => {
    const { port } = probe.address()
    probe.close(() => resolve(port))
  })
})
