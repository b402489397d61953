// The texts of errors in WebAssembly are those of the native program: node web/test/errors.mjs [PROGRAM [MODULE]]
// The module is compiled without the formatting of `Debug`, which leaves texts with gaps if one is used in a message.
import { spawnSync } from "node:child_process"
import { mkdtempSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs"
import { tmpdir } from "node:os"
import { join } from "node:path"
import { Machine } from "../machine.js"

const root = new URL("../../", import.meta.url).pathname
const [program = join(root, "target/release/ssplat"), module = join(root, "web/ssplat-simd.wasm")] = process.argv.slice(2)
const machine = () => new Machine(new WebAssembly.Module(readFileSync(module)))
const home = mkdtempSync(join(tmpdir(), "ssplat-errors-")), file = join(home, "a.ssplat")

// What is said of a file, without the ways to read what is left of it and the memory that is needed and allowed, which differ.
const plain = text => text.trim().replace(/^the file is /, "").replace(/; .*partial.*$/, "").replace(/alloc \d+ over the allowed \d+$/, "alloc")
const native = bytes => {
  writeFileSync(file, bytes)
  const { status, stderr } = spawnSync(program, ["decode", file, join(home, "a.pam")], { encoding: "utf8" })
  return status ? plain(stderr.replace(`ssplat: ${file}: `, "")) : undefined
}
const inWasm = bytes => {
  try {
    machine().decode(bytes)
  } catch (error) {
    return plain(error.message)
  }
}

let [same, failed] = [0, 0]
const kinds = new Set
const compare = (name, bytes) => {
  const [a, b] = [native(bytes), inWasm(bytes)]
  if (a && a == b) same++, kinds.add(a.replace(/\d+|\b[0-9a-f]{8}\b/g, "N"))
  else failed++, console.log(`FAILED: ${name}: native: ${a}; WebAssembly: ${b}`)
}
for (const folder of ["invalid", "limits"])
  for (const name of readdirSync(join(root, "spec/vectors", folder))) compare(`${folder}/${name}`, readFileSync(join(root, "spec/vectors", folder, name, "file.ssplat")))
const whole = readFileSync(join(root, "spec/vectors/valid/detail-rgb/file.ssplat"))
for (const length of [0, 4, 9, 12, 40, whole.length - 1]) compare(`${length} bytes`, whole.subarray(0, length))
// Files of other kinds.
for (const start of ["\x89PNG\r\n\x1a\n", "\xff\xd8\xff\xe0", "GIF89a", "<!doctype html>", "\n<html>", "version https://git-lfs.github.com/spec/v1", "\x1f\x8b\x08\0", "\x09SSP2345", "abcdefgh"])
  compare(JSON.stringify(start), Uint8Array.from(start, c => c.charCodeAt(0)))
rmSync(home, { recursive: true })
console.log(`${same} texts of ${kinds.size} kinds are the same, ${failed} differ`)
if (failed || kinds.size < 40) process.exit(1)
