// Tests `encodeFile` of ssplat/node: the program's bytes for the same pixels, orientation, profiles, depths, and typed errors.
import assert from "node:assert/strict"
import { execFileSync } from "node:child_process"
import { readFileSync, writeFileSync } from "node:fs"
import { join } from "node:path"
import { pathToFileURL } from "node:url"

const settings = { bytes: 900, effort: 1 }, args = ["--bytes", "900", "--effort", "1"]

// Pictures of each kind in `home`, made by sharp, with contents that the program reads, too.
async function write(home, sharp) {
  const width = 72, height = 48
  const generated = (channels, Samples) => {
    const top = Samples == Uint16Array ? 65535 : 255
    const data = Samples.from({ length: width * height * channels }, (_, i) => {
      const k = i % channels, at = (i - k) / channels, x = at % width / width, y = Math.floor(at / width) / height
      return top * ((x * (k + 1) + y * (3 - k) / 2) % 1 * 0.9 + Math.abs(Math.sin(i * 12.9898) * 43758.5453) % 0.1)
    })
    return sharp(data, { raw: { width, height, channels } })
  }
  const rgb = await generated(3, Uint8Array).png().toBuffer(), picture = () => sharp(rgb)
  const deep = (channels, space) => generated(channels, Uint16Array).toColourspace(space).png()
  const made = {
    "rgb.png": picture().png(),
    "rgba.png": generated(4, Uint8Array).png(),
    "grey.png": picture().greyscale().png(),
    "grey-alpha.png": generated(4, Uint8Array).greyscale().png(),
    "palette.png": picture().png({ palette: true }),
    "rgb16.png": deep(3, "rgb16"),
    "rgba16.png": deep(4, "rgb16"),
    "grey16.png": deep(1, "grey16"),
    "p3.png": picture().withIccProfile("p3").png(),
    "srgb.png": picture().withIccProfile("srgb").png(),
    "turned.jpg": picture().withMetadata({ orientation: 6 }).jpeg(),
    "cmyk.jpg": picture().toColourspace("cmyk").jpeg(),
    "large.png": picture().resize(700, 400).png(),
  }
  for (const [name, image] of Object.entries(made)) await image.toFile(join(home, name))
  writeFileSync(join(home, "cut.jpg"), readFileSync(join(home, "turned.jpg")).subarray(0, 1500))
  writeFileSync(join(home, "text.jpg"), "no picture")
}

export async function test({ home, program, encodeFile, sharp, decode, header }) {
  await write(home, sharp)
  const at = name => join(home, name), native = join(home, "native.ssplat")
  let same = 0
  // Decoders of PNG agree on every sample, unlike those of JPEG.
  for (const name of ["rgb.png", "rgba.png", "grey.png", "grey-alpha.png", "palette.png", "rgb16.png", "rgba16.png", "grey16.png", "p3.png", "srgb.png"]) {
    const { bytes, width, height, placeholder, report } = await encodeFile(at(name), settings)
    execFileSync(program, ["encode", "--quiet", at(name), native, ...args])
    assert(Buffer.compare(readFileSync(native), bytes) == 0, `${name}: other bytes than the program's`)
    assert.deepEqual([width, height, report.psnr > 0], [72, 48, true], name)
    const tiny = Buffer.from(placeholder.replace("data:image/x-ssplat;base64,", ""), "base64"), found = await header(tiny)
    assert(tiny.length <= 300 && tiny.length > 100 && found.width == 72 && found.depth == 8, `${name}: a placeholder of ${tiny.length} bytes`)
    same++
  }
  const said = execFileSync(program, ["placeholder", at("rgb.png"), "--format", "uri", "--effort", "1"]).toString().trim()
  assert.equal((await encodeFile(at("rgb.png"), settings)).placeholder, said, "other placeholder than the program's")

  const headerOf = async (name, options) => {
    const file = await encodeFile(at(name), { ...settings, placeholder: 0, ...options })
    assert.equal(file.placeholder, "")
    return { ...await header(file.bytes), given: [file.width, file.height] }
  }
  const turned = await headerOf("turned.jpg")
  assert.deepEqual([turned.width, turned.height, turned.orientation, turned.exif.length, ...turned.given], [48, 72, 1, 0, 48, 72], "the picture is not upright")
  // The left column of the file is the upper row of the picture.
  const upright = await decode((await encodeFile(at("turned.jpg"), { ratio: 2, effort: 1 })).bytes)
  const wanted = await sharp(at("turned.jpg")).rotate().removeAlpha().raw().toBuffer()
  const error = wanted.reduce((sum, v, i) => sum + (v - upright.data[4 * Math.floor(i / 3) + i % 3]) ** 2, 0) / wanted.length
  assert(error < 100, `the upright picture differs by ${error}`)
  assert((await headerOf("p3.png")).icc.length > 100 && !(await headerOf("srgb.png")).icc.length, "profiles are not kept, or needless ones are")
  assert.equal((await headerOf("rgb16.png")).depth, 16)
  const cmyk = await headerOf("cmyk.jpg")
  assert.deepEqual([cmyk.channels, cmyk.icc.length], [3, 0])
  assert.deepEqual((await headerOf("large.png", { maxSide: 350 })).given, [350, 200])
  assert.deepEqual((await headerOf("rgb.png", { maxSide: 350 })).given, [72, 48], "a picture is enlarged")
  assert.equal((await encodeFile(at("large.png"), { bytes: 3000, effort: 1 })).bytes.length <= 3000, true)
  // Bytes and URLs are pictures, too.
  const { bytes } = await encodeFile(at("rgb.png"), settings)
  for (const input of [readFileSync(at("rgb.png")), new Uint8Array(readFileSync(at("rgb.png"))), pathToFileURL(at("rgb.png"))]) assert.deepEqual((await encodeFile(input, settings)).bytes, bytes)

  const fails = (kind, words, input, options) => assert.rejects(encodeFile(input, { ...settings, ...options }), error => {
    assert(error.name == "SsplatError" && error.kind == kind && words.test(error.message), `${error.kind}: ${error.message}, not ${kind}: ${words}`)
    return true
  })
  await fails("format", /cut\.jpg: .*premature end/i, at("cut.jpg"))
  await fails("format", /text\.jpg: .*unsupported/, at("text.jpg"))
  await fails("format", /^the picture: /, Buffer.from("no picture"))
  await fails("parameter", /no option is called qualty; there are ratio, .*maxSide, placeholder$/, at("rgb.png"), { qualty: 70 })
  await fails("parameter", /no option is called icc/, at("rgb.png"), { icc: new Uint8Array(4) })
  await fails("parameter", /effort is 12/, at("rgb.png"), { effort: 12 })
  await fails("parameter", /maxSide is 0/, at("rgb.png"), { maxSide: 0 })
  await fails("parameter", /placeholder is 1\.5/, at("rgb.png"), { placeholder: 1.5 })
  await fails("parameter", /neither a path/, 7)
  await fails("size", /^placeholder: 5 bytes cannot hold/, at("rgb.png"), { placeholder: 5 })
  await assert.rejects(encodeFile(at("missing.png")), { code: "ENOENT" })
  await assert.rejects(encodeFile(at("rgb.png"), { signal: AbortSignal.abort(new Error("enough")) }), /enough/)
  return `${same} files with the program's bytes`
}
