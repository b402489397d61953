// Tests the types: this file must compile (npm run types).
import { Decoder, SsplatError, decode, header, type Pixels } from "ssplat"
import { encodeFile } from "ssplat/node"
import { SsplatImg } from "ssplat/ssplat-img.js"
import { decode as placeholder, read } from "ssplat/placeholder.js"

const element: SsplatImg = document.createElement("ssplat-img")
element.src = "photo.ssplat"
element.addEventListener("error", event => console.log(((event as ErrorEvent).error as SsplatError).kind === "network"))
const found = document.querySelector("ssplat-img")?.currentSrc satisfies string | undefined

const bytes = new Uint8Array(8)
const pixels: Pixels = await new Decoder({ worker: true }).decode(bytes, { width: 64, region: [0, 0, 8, 8] })
const icc: Uint8Array = (await header(bytes)).icc
const image = new ImageData(placeholder(bytes, 64).rgba, 64)
const [x, , major, , , color] = read(bytes).gaussians[0]
console.log(found, pixels.data, icc, image, x + major, color.length)

const file = await encodeFile("photo.jpg", { quality: 70, maxSide: 1536, placeholder: 200 })
element.placeholder = file.placeholder
element.width = file.width
console.log(file.bytes.length, file.report.psnr)

// @ts-expect-error: the orientation is that of the picture file.
await encodeFile("photo.jpg", { orientation: 6 })
// @ts-expect-error: a misspelt option is an error.
await decode(bytes, { widht: 64 })
