// Identifies files of other formats by their first bytes.

const kinds = [
  ["a PNG picture", /^89504e47/], ["a JPEG picture", /^ffd8ff/], ["a GIF picture", /^47494638/], ["a WebP picture", /^52494646.{8}57454250/],
  ["an AVIF picture", /^.{8}6674797061766966/], ["a JPEG XL picture", /^(ff0a|0000000c4a584c20)/], ["a HEIC picture", /^.{8}66747970(6865|6d69)/], ["a TIFF picture", /^(49492a00|4d4d002a)/],
  ["a BMP picture", /^424d/], ["an SVG drawing", /^3c(737667|3f786d6c)/], ["a PDF document", /^25504446/], ["a ZIP archive", /^504b0304/], ["a web page", /^(efbbbf)?(0d|0a|20)*3c(21|68|48)/],
]

export const isOurs = bytes => [0x89, 0x53, 0x53, 0x50].every((v, i) => bytes[i] == v)
export const isPicture = bytes => / picture$/.test(found(bytes).kind ?? "")

// Returns the kind of file, if it is known, and its first bytes.
export function found(bytes) {
  const start = Array.from(bytes.subarray(0, 16), v => v.toString(16).padStart(2, "0"))
  return { kind: bytes.length ? kinds.find(([, pattern]) => pattern.test(start.join("")))?.[0] : "an empty file", start: start.slice(0, 8).join(" ") }
}
