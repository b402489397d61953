// Tests decoding in Node.js and in browsers: the native decoder's samples, and typed errors.

// Returns a PAM file as RGBA with 8 bits, and whether it had more bits.
export function rgbaOfPam(bytes) {
  const text = new TextDecoder("latin1").decode(bytes), body = text.indexOf("ENDHDR\n") + 7
  const field = name => Number(new RegExp(`${name} (\\d+)`).exec(text)[1])
  const [columns, rows, depth, deep] = [field("WIDTH"), field("HEIGHT"), field("DEPTH"), field("MAXVAL") > 255]
  const sample = i => deep ? bytes[body + 2 * i] * 256 + bytes[body + 2 * i + 1] : bytes[body + i]
  const rgba = deep ? new Uint16Array(4 * columns * rows).fill(65535) : new Uint8Array(4 * columns * rows).fill(255)
  for (let i = 0; i < columns * rows; i++) {
    const v = Array.from({ length: depth }, (_, k) => sample(depth * i + k)), grey = [v[0], v[0], v[0], ...v.slice(1)]
    rgba.set(depth < 3 ? grey : v, 4 * i)
  }
  return { columns, rows, deep, rgba }
}

export function crc32(bytes) {
  let crc = -1
  for (const byte of bytes) {
    crc ^= byte
    for (let k = 0; k < 8; k++) crc = crc >>> 1 ^ (crc & 1 ? 0xEDB88320 : 0)
  }
  return ~crc >>> 0
}

const bytesOf = base64 => Uint8Array.from(atob(base64), letter => letter.charCodeAt(0))

const kindOf = { invalid: /^(format|version)$/, limits: /^limit$/ }

// Renders every case with `decoder`, and compares it with the result of the native decoder.
export async function run(cases, load, decoder) {
  const problems = []
  let same = 0, refused = 0, broken = 0
  const check = (good, words) => { if (!good) problems.push(words) }
  const attempt = async (question, ...values) => {
    try {
      return await decoder[question](...values)
    } catch (error) {
      return error
    }
  }
  for (const { path, width, height, columns, rows, deep, rgba, checksum } of cases) {
    const bytes = await load(path), answer = await attempt("decode", bytes, { width, height })
    if (!columns) {
      const kind = kindOf[path.split("/")[0]]
      check(answer instanceof Error && answer.name == "SsplatError" && kind.test(answer.kind) && answer.message, `${path}: ${answer.kind}, ${answer}`)
      refused++
      continue
    }
    check(answer.width == columns && answer.height == rows, `${path}: ${answer}`)
    if (answer instanceof Error) continue
    // 16 bits are rounded to 8.
    if (!deep) check(rgba ? answer.data.every((v, i) => v == rgba[i]) : crc32(answer.data) == checksum, `${path}: other samples than the native decoder's`)
    else if (rgba) check(answer.data.every((v, i) => Math.abs(rgba[i] - 257 * v) <= 129), `${path}: not the nearest of the native decoder's samples`)
    same++
    const info = await attempt("info", bytes), header = await attempt("header", bytes), all = await attempt("gaussians", bytes)
    check(info.parts?.reduce((sum, p) => sum + p.bytes, 0) == bytes.length, `${path}: info ${info} ${JSON.stringify(info.parts)}`)
    check(info.gaussians == all.count && header.gaussians == all.count && all.mean?.length == 2 * all.count, `${path}: ${all.count} of ${info.gaussians} Gaussians`)
    // The bits of the Gaussians add up to those of the fields.
    const each = info.each?.reduce((sum, bits) => sum + bits, 0), fields = info.fields?.reduce((sum, field) => sum + field.bits, 0)
    check(info.layout == "coded" ? info.each?.length == all.count && (!all.count || Math.abs(each - fields) < .01 * fields + 1) : info.each?.length == 0, `${path}: ${each} bits of ${info.each?.length} Gaussians, ${fields} of all fields`)
    // A region equals the same part of the whole picture.
    if (!width && columns > 2 && rows > 2 && columns * rows < 1e6) {
      const [left, top] = [columns >> 2, rows >> 2], part = await attempt("decode", bytes, { region: [left, top, 2, 2] })
      const inside = [0, 1].flatMap(y => [...answer.data.subarray(4 * ((top + y) * columns + left), 4 * ((top + y) * columns + left + 2))])
      check(inside.every((v, i) => v == part.data?.[i]), `${path}: a part is not the whole's: ${part}`)
    }
    // Damaged files give a typed error other than `internal`, or a different picture.
    for (let i = 0; i < 12; i++) {
      const other = bytes.slice()
      other[5 + Math.floor(other.length * i / 12) % Math.max(1, other.length - 9)] ^= 1 << i % 8
      new DataView(other.buffer).setUint32(other.length - 4, crc32(other.subarray(0, -4)), true)
      const answer = await attempt("header", other)
      const drawn = answer.width * answer.height < 1e6 ? await attempt("decode", other) : answer
      check(!(drawn instanceof Error) || drawn.name == "SsplatError" && drawn.kind != "internal", `${path}, broken ${i}: ${drawn.stack}`)
      broken++
    }
  }
  const [first] = cases, bytes = await load(first.path)
  for (const [options, kind] of [[{ region: [0, 0, 1 << 20, 1] }, "parameter"], [{ width: 1.5 }, "parameter"], [{ limits: { alloc: 1 } }, "limit"], [{ limits: { nonsense: 1 } }, "parameter"], [{ width: 0 }, "parameter"], [{ width: 8, height: 0 }, "parameter"], [{ height: 0 }, "parameter"], [{ widht: 8 }, "parameter"], [{ detail: "none" }, "parameter"]])
    check((await attempt("decode", bytes, options)).kind == kind, `${JSON.stringify(options)} is not refused as ${kind}`)
  // A height alone keeps the aspect ratio, as a width alone does.
  for (const [region, [columns, rows]] of [[undefined, [first.columns, first.rows]], [[0, 0, 3, 2], [3, 2]]]) {
    const tall = await attempt("decode", bytes, { region, height: 9 }), same = await attempt("decode", bytes, { region, width: Math.round(columns * 9 / rows), height: 9 })
    check(tall.height == 9 && tall.width == same.width && tall.data?.every((v, i) => v == same.data[i]), `a height alone: ${tall}`)
  }
  // In a file without a detail layer, the Gaussians are the whole picture, and the layer is plain grey.
  const [on, off, alone] = await Promise.all(["on", "off", "alone"].map(detail => attempt("decode", bytes, { detail })))
  check(on.data?.every((v, i) => v == off.data?.[i]), "without a detail layer more than the Gaussians is drawn")
  check(alone.data?.every((v, i) => i % 4 == 3 || v == alone.data[0]), "a detail layer is drawn where there is none")
  check((await attempt("decode", "text")).kind == "parameter", "text is not refused")
  // Missing parts are reported: a tile of a layer, and all tiles of a layer that has not arrived, for which no memory is allocated.
  const damaged = bytesOf("iVNTUAaSKBgGkGRoAUR0YWwId89qax39aYmsvAIAxehVgJ61qMS8G4VlvDZ/0UHZcebJzHSA74FaRvU7yY3sU0ORon5eCeIxL0LQN/TtRL8zVSN9fWqsCXkcy4klICJP2fKrFjR2zMDe5EYEa8/0OWdX1p8WfFfqDVWYr1Q=")
  check((await attempt("decode", damaged)).kind == "format", "a damaged tile is not refused")
  const left = await attempt("decode", damaged, { partial: true })
  check(left.missing === 0 && left.missingTiles === 1 && left.damaged === true, `of a damaged tile is told ${left.missing}, ${left.missingTiles}, ${left.damaged}: ${left}`)
  const arriving = bytesOf("iVNTUAaCgIAYgIBAAJRkaAFEdGFsCB1E2E0A6wQwOUAAAICAgICAgICAgICAgICAgICAgICAgICAgICAgICAgICAgICAgICAgIA=")
  const glimpse = await attempt("decode", arriving, { partial: true, width: 10, limits: { alloc: 1 << 20 } })
  check(glimpse.missingTiles === 1536 * 4096 && glimpse.damaged === true, `of a layer that has not arrived is told ${glimpse.missingTiles}, ${glimpse.damaged}: ${glimpse}`)
  const whole = await attempt("decode", bytes)
  check(whole.missing === 0 && whole.missingTiles === 0 && whole.damaged === false, "something of a whole file is missing")
  check(same > 30 && refused > 40, `only ${same} files were drawn and ${refused} refused`)
  return { problems, words: `${same} files with the native samples, ${refused} refused, ${broken} broken on purpose` }
}
