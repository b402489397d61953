// Decodes in Node.js, as on a server that renders pages: node node.js FILE [OUT.ppm]. The element can be imported, but is not registered
// there.
import { readFileSync, writeFileSync } from "node:fs"
import { Decoder } from "ssplat"
import { decode as placeholder } from "ssplat/placeholder.js"
import "ssplat/ssplat-img.js"

const [, , path, out] = process.argv, file = readFileSync(path)
const { width, height, data, channels, orientation } = await new Decoder().decode(file)
console.log(`${path}: ${width} × ${height} pixels of ${channels} channels, orientation ${orientation}`)
if (out) writeFileSync(out, Buffer.concat([Buffer.from(`P6 ${width} ${height} 255\n`), data.filter((_, i) => i % 4 < 3)]))
try {
  console.log(`as a placeholder: ${placeholder(file, 64).rgba.length / 4} pixels`)
} catch (error) {
  console.log(`as a placeholder: ${error.kind}`)
}
