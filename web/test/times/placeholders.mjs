// Prints when a page shows its 100 placeholders in Chromium, over 10 loads: node web/test/times/placeholders.mjs FILE... The files are
// repeated until there are 100.
import { readFileSync } from "node:fs"
import { inChromium } from "../chromium.mjs"

const files = process.argv.slice(2).map(name => [name, readFileSync(name).toString("base64")])
const answer = await inChromium(new URL("../../../", import.meta.url), "/web/test/times/placeholders.js", files)
for (const line of answer?.lines ?? answer?.problems ?? ["no Chromium"]) console.log(line)
