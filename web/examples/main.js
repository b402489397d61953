// A page that uses the package, the same for every bundler: it shows a file with the element, and renders a part of it with the decoder.
import { Decoder } from "ssplat"
import "ssplat/ssplat-img.js"

const decoder = new Decoder({ worker: true }), canvas = document.getElementById("part")
const file = await (await fetch("photo.ssplat")).arrayBuffer()
const image = await decoder.decode(file, { region: [0, 0, 256, 256], width: 512 })
Object.assign(canvas, { width: image.width, height: image.height })
canvas.getContext("2d").putImageData(image, 0, 0)
