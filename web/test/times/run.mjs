// Prints decoding times in Node.js and in Chromium: node web/test/times/run.mjs FILE... Minimum and median of many runs in milliseconds: at
// the file's own size, in new memory and in the memory of the previous picture, and 64 pixels wide.
import { readFileSync } from "node:fs"
import { Decoder } from "../../dist/ssplat.js"
import { inChromium } from "../chromium.mjs"
import { measure } from "./measure.js"

const files = process.argv.slice(2).map(name => [name.split("/").pop(), readFileSync(name).toString("base64")])
for (const kind of ["simd", "scalar"]) {
  const decoder = new Decoder({ module: readFileSync(new URL(`../../dist/ssplat-${kind}.wasm`, import.meta.url)) })
  for (const line of await measure(decoder, files)) console.log(`Node.js, ${kind}: ${line}`)
}
const answer = await inChromium(new URL("../../../", import.meta.url), "/web/test/times/measure.js", files)
for (const line of answer?.lines ?? ["no Chromium"]) console.log(`Chromium: ${line}`)
