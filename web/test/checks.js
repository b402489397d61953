// Tests placeholder.js on the vectors and on randomly damaged files.
import { decode, read, SsplatError } from "../placeholder.js"

// Returns the samples of a PAM file as RGBA with 8 bits.
function pam(bytes) {
  const text = new TextDecoder("latin1").decode(bytes), body = text.indexOf("ENDHDR\n") + 7
  const field = name => Number(new RegExp(`${name} (\\d+)`).exec(text)[1])
  const [width, height, depth, wide] = [field("WIDTH"), field("HEIGHT"), field("DEPTH"), field("MAXVAL") > 255]
  const sample = i => wide ? Math.floor((bytes[body + 2 * i] * 256 + bytes[body + 2 * i + 1] + 128) / 257) : bytes[body + i]
  const rgba = new Uint8Array(4 * width * height)
  for (let i = 0; i < width * height; i++) {
    const v = Array.from({ length: depth }, (_, k) => sample(depth * i + k))
    rgba.set(depth < 3 ? [v[0], v[0], v[0], v[1] ?? 255] : [v[0], v[1], v[2], v[3] ?? 255], 4 * i)
  }
  return { width, height, rgba }
}

function crc32(bytes) {
  let crc = -1
  for (const byte of bytes) {
    crc ^= byte
    for (let k = 0; k < 8; k++) crc = crc >>> 1 ^ (crc & 1 ? 0xEDB88320 : 0)
  }
  return ~crc >>> 0
}

const attempt = (work, bytes) => {
  try {
    return work(bytes)
  } catch (error) {
    return error
  }
}

// One stream, no codebook, no sections: the files that this decoder supports.
const claimed = bytes => bytes.length <= 16388 && (bytes[5] & 3) == 2 && !(bytes[5] & 192)

// `names` lists the folders of valid, invalid and limits; `load` returns the bytes of a path below the vectors.
export async function run(names, load) {
  const problems = []
  let drawn = 0, refused = 0, damaged = 0
  const check = (good, words) => { if (!good) problems.push(words) }
  for (const name of names.valid) {
    const bytes = await load(`valid/${name}/file.ssplat`), result = attempt(decode, bytes)
    if (!claimed(bytes)) {
      check(result instanceof SsplatError && /^(unsupported|limit)$/.test(result.kind), `${name}: should be refused as another kind of file: ${result}`)
      if (name.startsWith("detail-")) check(result.message.includes("detail layer"), `${name}: the reason is not named: ${result.message}`)
      refused++
      continue
    }
    const expected = pam(await load(`valid/${name}/picture.pam`))
    check(result.width == expected.width && result.height == expected.height, `${name}: ${result}`)
    if (result instanceof Error) continue
    const worst = expected.rgba.reduce((most, v, i) => Math.max(most, Math.abs(v - result.rgba[i])), 0)
    check(worst <= 1, `${name}: a sample is off by ${worst}`)
    drawn++
    // Damaged files give a typed error, or a different picture if the checksum matches.
    for (let i = 0; i < 40; i++) {
      const broken = bytes.slice()
      broken[5 + Math.floor(broken.length * i / 40) % (broken.length - 9)] ^= 1 << i % 8
      new DataView(broken.buffer).setUint32(broken.length - 4, crc32(broken.subarray(0, -4)), true)
      const result = attempt(read, broken)
      check(!(result instanceof Error) || result instanceof SsplatError, `${name}, broken ${i}: ${result.stack}`)
      damaged++
    }
  }
  for (const folder of ["invalid", "limits"])
    for (const name of names[folder]) {
      const result = attempt(decode, await load(`${folder}/${name}/file.ssplat`))
      check(result instanceof SsplatError, `${folder}/${name}: ${result instanceof Error ? result.stack : "was drawn"}`)
      if (name.startsWith("coded-") && !name.includes("codebook")) check(result.kind == "format", `${folder}/${name}: ${result.kind}, ${result.message}`)
      refused++
    }
  const whole = await load(`valid/${names.valid.find(name => name == "coded-rgb")}/file.ssplat`)
  for (const size of [[0], [8, 0], [1.5], [-1]]) check(attempt(b => decode(b, ...size), whole).kind == "parameter", `a size of ${size} is not refused`)
  // 64 columns of a picture of 1 × 4096 pixels are 262144 rows; with both sides the size is the caller's.
  const strip = Uint8Array.from([0x89, 0x53, 0x53, 0x50, 6, 0x1a, 1, 0x80, 0x20, 0, 0x94, 0x64, 0x68, 8, 0xef, 0xa3, 0x64])
  for (const size of [[64], [17]]) check(attempt(b => decode(b, ...size), strip).kind == "limit", `${size[0]} columns of a strip are not refused`)
  for (const size of [[], [15], [64, 64]]) check(attempt(b => decode(b, ...size), strip).width == (size[0] ?? 1), `a strip is not drawn in ${size}`)
  check(drawn > 10, `only ${drawn} vectors were drawn`)
  return { problems, words: `${drawn} vectors drawn, ${refused} refused, ${damaged} broken on purpose` }
}
