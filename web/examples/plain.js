// The same without a bundler: the folder of the package is served unchanged.
import { Decoder } from "./node_modules/ssplat/ssplat.js"
import "./node_modules/ssplat/ssplat-img.js"

const decoder = new Decoder({ worker: true }), canvas = document.getElementById("part")
const file = await (await fetch("photo.ssplat")).arrayBuffer()
const image = await decoder.decode(file, { region: [0, 0, 256, 256], width: 512 })
Object.assign(canvas, { width: image.width, height: image.height })
canvas.getContext("2d").putImageData(image, 0, 0)
