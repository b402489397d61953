// Chooses the canvas colour space for an ICC profile or code points.

// Red, green and blue of Display P3 in the profile connection space.
const p3 = [[.5151, .2412, -.0011], [.292, .6922, .0419], [.1571, .0666, .7841]]

// Returns "display-p3" for code points or a profile of it, and "srgb" for all others and if there is none. Code points take precedence.
export function colorSpace(icc, cicp) {
  if (cicp?.length == 4) return `${cicp}` == "12,13,0,1" ? "display-p3" : "srgb"
  if (!icc || icc.length < 132) return "srgb"
  const view = new DataView(icc.buffer, icc.byteOffset, icc.length), tags = Math.min(view.getUint32(128), 100)
  const primary = name => {
    for (let at = 132; at + 12 <= Math.min(icc.length, 132 + 12 * tags); at += 12) {
      if (String.fromCharCode(...icc.subarray(at, at + 4)) != name) continue
      const place = view.getUint32(at + 4)
      return place + 20 > icc.length ? undefined : [8, 12, 16].map(k => view.getInt32(place + k) / 65536)
    }
  }
  const near = ["rXYZ", "gXYZ", "bXYZ"].every((name, k) => primary(name)?.every((v, i) => Math.abs(v - p3[k][i]) < .003))
  return near ? "display-p3" : "srgb"
}
