// Reads PNG files of 8 bits, without palette and not interlaced, such as those of tests/images: their samples, and their ICC profile.
import { inflateSync } from "node:zlib"

export function pixelsOfPng(file) {
  const view = new DataView(file.buffer, file.byteOffset, file.byteLength), parts = []
  let width, height, channels, icc
  for (let at = 8; at < file.length; at += 12 + view.getUint32(at)) {
    const kind = file.toString("latin1", at + 4, at + 8), body = file.subarray(at + 8, at + 8 + view.getUint32(at))
    if (kind == "IHDR") {
      [width, height] = [view.getUint32(at + 8), view.getUint32(at + 12)]
      channels = { 0: 1, 2: 3, 4: 2, 6: 4 }[body[9]]
      if (body[8] != 8 || !channels || body[12] != 0) throw new Error("not 8 bits per sample")
    }
    if (kind == "iCCP") icc = new Uint8Array(inflateSync(body.subarray(body.indexOf(0) + 2)))
    if (kind == "IDAT") parts.push(body)
  }
  const raw = inflateSync(Buffer.concat(parts)), row = channels * width, data = new Uint8Array(row * height)
  for (let y = 0; y < height; y++)
    for (let x = 0; x < row; x++) {
      const at = y * row + x, a = x >= channels ? data[at - channels] : 0, b = y ? data[at - row] : 0, c = x >= channels && y ? data[at - row - channels] : 0
      const [da, db, dc] = [b - c, a - c, a + b - 2 * c].map(Math.abs)
      const paeth = da <= db && da <= dc ? a : db <= dc ? b : c
      data[at] = raw[y * (row + 1) + 1 + x] + [0, a, b, a + b >> 1, paeth][raw[y * (row + 1)]]
    }
  return { width, height, channels, data, icc }
}
