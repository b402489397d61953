// Checks that the WebAssembly accepts and rejects the same files as the native decoder, and renders the same: for the finds of fuzzing, the
// vectors, and mutations of them. The native decoder's list comes first: cargo run --release -p ssplat-lab --example acceptance -- FOLDER
// && node web/test/acceptance.mjs FOLDER [MODULE...] MODULE is web/ssplat-simd.wasm by default.
import { readFileSync } from "node:fs"
import { join } from "node:path"
import { Decoder } from "../ssplat.js"
import { crc32 } from "./files.js"

const [folder, ...named] = process.argv.slice(2)
const modules = named.length ? named : [new URL("../ssplat-simd.wasm", import.meta.url).pathname]
// Those of examples/acceptance.rs.
const limits = { width: 1 << 12, height: 1 << 12, gaussians: 1 << 16, alloc: 512 << 20, tilePairs: 1 << 20 }
const all = new Uint8Array(readFileSync(join(folder, "files.bin")))
const list = readFileSync(join(folder, "list.txt"), "utf8").trim().split("\n").map(line => line.split(" "))

let failed = 0
for (const path of modules) {
  const decoder = new Decoder({ module: readFileSync(path) })
  const outcomes = {}
  let at = 0, different = 0
  for (const [name, length, outcome, width, height, drawn] of list) {
    const bytes = all.slice(at, at += +length), region = [0, 0, +width, +height]
    const kind = error => error.name == "SsplatError" ? error.kind : `${error}`
    // A file with an invalid header has no region.
    const found = await decoder.info(bytes, { limits }).then(() => "file", kind)
    const seen = await decoder.decode(bytes, { limits, ...(+width && { region }) }).then(({ data }) => `${crc32(data)}`, kind)
    if (found != outcome || seen != drawn) {
      different++
      if (different <= 20) console.log(`FAILED: ${name}: ${found} and ${seen}, natively ${outcome} and ${drawn}`)
    }
    outcomes[outcome] = (outcomes[outcome] ?? 0) + 1
  }
  console.log(`${path}: ${list.length} files, natively ${JSON.stringify(outcomes)}, ${different} differ`)
  // A list without failures would prove nothing.
  if (different || !(outcomes.file > 100 && outcomes.format > 100)) failed++
}
process.exit(failed ? 1 : 0)
