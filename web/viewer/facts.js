// The facts about a file: its figures, the distribution of its bytes, and the bits of its Gaussians.

const number = v => v.toLocaleString("en")
const colours = ["#3f7de0", "#f0803c", "#45b07c", "#b06fd8", "#d8b23a", "#d8577a", "#4fb3c4", "#8a8f98", "#9a7048", "#6d6fe0"]

// Formats a size, such as 812 bytes, 14.0 kB or 1.2 MB.
export const size = bytes => bytes < 1000 ? `${bytes} bytes` : bytes < 999950 ? `${(bytes / 1000).toFixed(bytes < 99950 ? 1 : 0)} kB` : `${(bytes / 1e6).toFixed(1)} MB`

function make(name, contents, properties = {}) {
  const element = Object.assign(document.createElement(name), properties)
  element.append(...contents)
  return element
}

const table = rows => make("table", rows.map(row => make("tr", row.map(cell => make("td", [].concat(cell))))))
const colour = k => {
  const element = make("i", [])
  element.style.background = colours[k % colours.length]
  return element
}

// Shows parts of a total: a bar, and a row for each part.
function shares(title, rows, words) {
  const whole = rows.reduce((sum, [, v]) => sum + v, 0), bar = make("div", [], { className: "bar" })
  for (const [k, [, v]] of rows.entries()) {
    const piece = make("span", [])
    piece.style.cssText = `flex: ${v / whole || 0}; background: ${colours[k % colours.length]}`
    bar.append(piece)
  }
  bar.ariaHidden = "true"
  return [make("h2", [title]), bar, table(rows.map(([name, v], k) => [[colour(k), name], words(v)]))]
}

// Returns one line: the size of the picture, the size of the file, and the number of Gaussians.
export const summary = info => `${info.width} × ${info.height} · ${size(info.bytes)} · ${number(info.gaussians)} Gaussian${info.gaussians == 1 ? "" : "s"}`

// Returns all facts as elements.
export function facts(info) {
  const kinds = ["", "grey", "grey and alpha", "colour", "colour and alpha"], pixels = info.width * info.height, raw = pixels * info.channels * info.depth / 8
  const numbers = [[size(info.bytes), "the file"], [`1 : ${number(Math.round(raw / info.bytes))}`, `of ${size(raw)} raw`], [number(info.gaussians), "Gaussians"], [(8 * info.bytes / pixels).toPrecision(3), "bits a pixel"]]
  const some = rows => rows.filter(([, v]) => v > 0), fields = some(info.fields.map(f => [f.name, f.bits]))
  return [
    make("div", numbers.map(([v, words]) => make("div", [make("b", [v]), make("span", [words])])), { id: "numbers" }),
    ...shares("Where the bytes go", some(info.parts.map(p => [p.name, p.bytes])), number),
    ...fields.length ? shares("Bits of a Gaussian", fields, bits => (bits / info.gaussians).toFixed(2)) : [],
    ...info.sections.length ? [make("h2", ["Sections, bytes"]), table(info.sections.map(s => [s.name, number(s.bytes)]))] : [],
    make("h2", ["Picture"]),
    table([["Size", `${info.width} × ${info.height}`], ["Channels", kinds[info.channels]], ["Depth", `${info.depth} bits`], ["Orientation", info.orientation], ...info.cicp?.length ? [["Code points", info.cicp.join(", ")]] : [], ["ICC profile", info.icc.length ? `${number(info.icc.length)} bytes` : "none"], ["EXIF", info.exif.length ? `${number(info.exif.length)} bytes` : "none"]]),
    make("h2", ["Format"]),
    table([["Version", info.version], ["Layout", info.layout], ["Blend", info.blend], ["Levels", Math.max(1, info.levels.length)], ["Groups", info.groups], ["Codebook", info.codebook || "none"]]),
  ]
}
