// Adds metadata to .ssplat files, for tests.
import { crc32 } from "./files.js"

// Adds these sections to a file without sections.
export function withSections(file, sections) {
  const long = bytes => new Uint8Array(new Uint32Array([crc32(bytes)]).buffer), varint = v => v < 128 ? [v] : [v & 127 | 128, ...varint(v >> 7)]
  let end = 6
  for (let i = 0; i < 3; i++) while (file[end++] > 127);
  const head = [...file.subarray(0, end + 3), Object.keys(sections).length]
  head[5] |= 128
  // The file's checksum covers everything except the contents of the sections; that of a section starts from the header's.
  const header = long(Uint8Array.from(head.slice(0, -1)))
  const whole = [...head], bare = [...head]
  for (const [name, contents] of Object.entries(sections)) {
    const letters = [...new TextEncoder().encode(name)], all = [...letters, ...varint(contents.length), ...long(Uint8Array.from([...header, ...letters, ...contents]))]
    whole.push(...all, ...contents)
    bare.push(...all)
  }
  const payload = file.subarray(end + 3, -4)
  return Uint8Array.from([...whole, ...payload, ...long(Uint8Array.from([...bare, ...payload]))])
}

// An EXIF block with an orientation, and an ICC profile that contains only its primaries.
export const exif = orientation => Uint8Array.of(73, 73, 42, 0, 8, 0, 0, 0, 1, 0, 0x12, 1, 3, 0, 1, 0, 0, 0, orientation, 0, 0, 0, 0, 0, 0, 0)
export function profile(primaries) {
  const bytes = new Uint8Array(132 + 32 * 3), view = new DataView(bytes.buffer)
  view.setUint32(128, 3)
  primaries.forEach((xyz, k) => {
    bytes.set(new TextEncoder().encode(`${"rgb"[k]}XYZ`), 132 + 12 * k)
    view.setUint32(136 + 12 * k, 168 + 20 * k)
    view.setUint32(140 + 12 * k, 20)
    bytes.set(new TextEncoder().encode("XYZ "), 168 + 20 * k)
    xyz.forEach((v, i) => view.setInt32(176 + 20 * k + 4 * i, Math.round(65536 * v)))
  })
  return bytes
}
