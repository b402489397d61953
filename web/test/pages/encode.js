// Tests the encoder in a page and in a worker: the bytes of Node.js, cancelling, and several encodes at a time.
import { encode, ssimulacra2 } from "/web/dist/encode.js"
import { crc32 } from "/web/test/files.js"
import { generated } from "/web/test/generated.js"

// The best of a few attempts, because the machine may be busy.
const attempts = 5, soon = 50

async function cancelled(pixels) {
  const control = new AbortController()
  let asked
  const encoding = encode(pixels, { effort: 9, signal: control.signal, onProgress: () => setTimeout(() => {
    asked ??= performance.now()
    control.abort(new Error("enough"))
  }, 30) })
  const error = await encoding.catch(e => e)
  return { words: error.message, waited: performance.now() - asked }
}

export async function test(_, { encoded }) {
  const problems = []
  let checks = 0
  const check = (good, words) => {
    checks++
    if (!good) problems.push(words)
  }
  const of = ({ width, height, channels, depth }) => generated(width, height, channels, depth)
  for (const { name, picture, options, checksum } of encoded)
    for (const worker of [true, false]) {
      const { bytes } = await encode(of(picture), { ...options, worker })
      check(crc32(bytes) == checksum, `${name}, ${worker ? "in a worker" : "on the page's thread"}: ${bytes.length} other bytes than Node.js's`)
    }

  const all = await Promise.all(encoded.map(({ picture, options }) => encode(of(picture), options)))
  check(all.every(({ bytes }, i) => crc32(bytes) == encoded[i].checksum), "several at a time give other bytes")

  const large = generated(600, 400, 3, 8), waits = []
  for (let i = 0; i < attempts; i++) {
    const { words, waited } = await cancelled(large)
    check(words == "enough", `a cancelled encode ends with ${words}`)
    waits.push(waited)
  }
  check(Math.min(...waits) < soon, `cancelled after ${waits.map(v => v.toFixed(0)).join(", ")} ms`)

  const image = new ImageData(64, 48)
  image.data.fill(200)
  check((await encode(image, { bytes: 300 })).bytes.length <= 300, "ImageData is not encoded")
  check(await ssimulacra2(large, large) == 100, "a picture is not like itself")
  const refused = await encode(image, { bytes: 300, effect: 2 }).catch(e => e)
  check(refused.kind == "parameter" && /effect/.test(refused.message), `a slip is ${refused.kind}: ${refused.message}`)
  return { problems, words: `${checks} promises, cancelled within ${Math.min(...waits).toFixed(1)} ms` }
}
