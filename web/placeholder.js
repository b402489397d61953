// Reads small .ssplat files without WebAssembly: one coded stream (spec §8), no codebook, no sections, at most 16 KiB. decode(bytes, width,
// height) gives {width, height, rgba, picture}; a file that is broken or of another kind throws a SsplatError.
export class SsplatError extends Error {
  constructor(kind, words) {
    super(words)
    this.name = "SsplatError"
    this.kind = kind
  }
}
const { floor, ceil, trunc, min, max, abs, hypot, exp, sin, cos, tan, log2, PI } = Math
const stop = (kind, words) => { throw new SsplatError(kind, words) }
const broken = what => stop("format", what + " is illegal")
const power = exponent => 2 ** exponent
const clamp = (v, low, high) => min(max(v, low), high)
const round = v => floor(v + .5)
const array = (length, make) => Array.from({ length }, (_, i) => make(i))
const bits = v => v < 1 ? 0 : floor(v).toString(2).length
const ilog2 = v => bits(v) - 1
const log16 = v => 16 * ilog2(v) + (floor(v * 16 / power(ilog2(v))) & 15)
// Tables of spec §8.2 and §8.6.
const logistic = array(4097, i => round(65536 / (1 + exp((2048 - i) / 256))))
const inverse = array(321, i => round(65536 * 512 * Math.LN2 / power(i / 16 - 8)))
const tangents = array(16, j => round(4096 * tan(PI * (2 * j + 1) / 64)))
const directions = array(64, k => [cos, sin].map(f => round(256 * f(PI * k / 32))))
const stayChances = [251, 251, 249, 243, 222, 195, 164, 137, 102, 71, 46, 25, 13, 8, 4, 2, 2, 2, 2, 2, 2, 2, 2, 2]
const accordLogs = [112, 112, 86, 79, 72, 63]

function crc32(bytes, end) {
  let crc = -1
  for (let i = 0; i < end; i++) {
    crc ^= bytes[i]
    for (let k = 0; k < 8; k++) crc = crc >>> 1 ^ (crc & 1 ? 0xEDB88320 : 0)
  }
  return ~crc >>> 0
}

// The range coder of spec §8.1 over bytes[start .. end].
function rangeDecoder(bytes, start, end) {
  let at = start, code = 0, range = 0xFFFFFFFF
  const next = () => { code = code * 256 + (at < end ? bytes[at] : 0); at++ }
  for (let i = 0; i < 4; i++) next()
  if (code == 0xFFFFFFFF) broken("start of the stream")
  const refill = () => { while (range < 16777216) { range *= 256; next() } }
  const take = (unit, below, above, total) => {
    code -= unit * below
    range = above == total ? range - unit * below : unit * (above - below)
    refill()
  }
  const coder = {
    bit(one) {
      const bound = (range >>> 16) * one, set = code < bound
      if (set) range = bound
      else { range -= bound; code -= bound }
      refill()
      return +set
    },
    // Returns the value in low .. high whose interval contains the code, with the ends of the interval and the total.
    choose(below, low, high) {
      const total = below(high), unit = floor(range / total), target = min(floor(code / unit), total - 1)
      let from = 0, to = total
      while (high - low > 1) {
        const middle = low + high >> 1, share = below(middle)
        if (share <= target) { low = middle; from = share } else { high = middle; to = share }
      }
      take(unit, from, to, total)
      return [low, from, to, total]
    },
    uniform(n) {
      const unit = floor(range / n), v = min(floor(code / unit), n - 1)
      take(unit, v, v + 1, n)
      return v
    },
    raw: n => n > 16 ? coder.uniform(power(n - 16)) * 65536 + coder.uniform(65536) : coder.uniform(power(n)),
    pair(a, b) {
      if (a + b > 16) return [coder.raw(a), coder.raw(b)]
      const v = coder.raw(a + b)
      return [v >> b, v & power(b) - 1]
    },
    // Checks that the stream is canonical and completely read.
    finish() {
      const place = 8 * (at - end), unit = power(place), last = bytes[end - 1]
      if (end > start && (place < 0 || !last ||
        place < 32 && !(code < unit && code < last * unit && code + (256 - last) * unit >= range))) broken("end of the stream")
    }
  }
  return coder
}

// Values near a place (spec §8.2).
function near(coder, place, spread) {
  const steep = inverse[clamp(spread, 80, 320)]
  const chance = v => {
    const t = clamp(floor((16 * v - 8 - place) * steep / 65536), -32767, 32767) + 32768, i = t >> 4
    return logistic[i] + ((logistic[i + 1] - logistic[i]) * (t & 15) >> 4)
  }
  return {
    distance: v => min(floor(abs(16 * v - place) * steep / 65536), 32767),
    bounded(low, count, share) {
      const least = chance(low), each = floor(share / count) + 1
      return coder.choose(v => chance(v) - least + each * (v - low), low, low + count)
    },
    open() {
      const middle = place + 8 >> 4
      const below = v => abs(v) == 128 ? 256 * (v + 128) : floor(chance(middle + v) * 65280 / 65536) + v + 128
      const step = coder.choose(below, -128, 128)[0]
      if (step > -128 && step < 127) return middle + step
      const n = coder.uniform(18), rest = power(n) + coder.raw(n) - 1
      return step < 0 ? middle - 128 - rest : middle + 127 + rest
    }
  }
}

// Gains for kinds with this many classes each.
function gains(...sizes) {
  const all = sizes.map(size => array(size, () => [0, 0]))
  return {
    sum: classes => all.reduce((sum, kind, i) => sum + kind[classes[i]][0], 0) >> 16,
    learn(classes, distance) {
      all.forEach((kind, i) => {
        const gain = kind[classes[i]]
        gain[0] = clamp(gain[0] + floor((distance - 5678) * max(1024, floor(65536 / (gain[1] + 12))) / 256), -8388608, 8388608)
        gain[1] = min(gain[1] + 1, 64)
      })
    }
  }
}

// Adaptive bits (spec §8.3).
function slots(coder, count, limit) {
  const all = array(count, () => [1 << 21, 0])
  return {
    all,
    bit(index) {
      const slot = all[index], bit = coder.bit(clamp(slot[0] >> 6, 32, 65504))
      slot[0] += floor(((bit ? 4194303 : 0) - slot[0]) * floor(65536 / (slot[1] + 2)) / 65536)
      slot[1] = min(slot[1] + 1, limit)
      return bit
    }
  }
}

// Header and integers, as Gaussians [x, y, major deviation, minor deviation, rotation, colour].
export function read(bytes) {
  const end = bytes.length - 4
  let at = 6
  if (end > 16384) stop("limit", `file is ${bytes.length}, at most 16388 is allowed`)
  if ([0x89, 0x53, 0x53, 0x50].some((v, i) => bytes[i] != v)) stop("format", "not an ssplat file")
  if (bytes[4] != 6) stop("version", `version ${bytes[4]} is not known`)
  const flags = bytes[5]
  if ((flags & 3) != 2 || flags & 192) stop("unsupported", flags & 128 ? "a file with sections: a detail layer, a profile or a thumbnail" : "not one coded stream without codebook")
  const byte = () => at < end ? bytes[at++] : broken("end of the header")
  const varint = (what, low, high) => {
    let v = 0, place = 1, b
    do {
      b = byte()
      v += (b & 127) * place
      place *= 128
    } while (b > 127 && place < power(56))
    if (b > 127 || !b && place > 128 || v < low) broken(what)
    if (v > high) stop("limit", `${what} is ${v}, at most ${high} is allowed`)
    return v
  }
  const size = [varint("width", 1, 1048576), varint("height", 1, 1048576)]
  const count = varint("count", 0, 4294967295), steps = [byte(), byte(), byte()]
  const channels = 1 + (flags >> 3 & 3), Delta = (steps[0] & 15) + 4, delta = Delta / 32, tau = power(((steps[0] >> 4 & 3) - 1) / 2)
  const position = steps[1] & 15, coarsest = (steps[2] & 15) - 6, range = steps[2] >> 4, finest = coarsest - range
  if (finest < -10) broken("step")
  if (crc32(bytes, end) != new DataView(bytes.buffer, bytes.byteOffset + end).getUint32(0, true)) broken("checksum")
  if (count > 8 * (end - at) + 1024) broken("count")
  const top = min(255, floor(704 / Delta)), grid = size.map(s => ceil(s / power(finest)))
  const angles = array(256, d => {
    const r = power(d * delta)
    return d ? clamp(ceil(PI * (r - 1 / r) / (Math.SQRT2 * delta * Math.LN2 * tau)), 1, 4096) : 1
  })
  const luma = power((steps[1] >> 4) / 3 - 7), chroma = channels > 2 ? luma * [1, 1.5, 2, 3][steps[0] >> 6] : luma
  // Bounds of the colour integers, and of colours: 8, with a margin for rounding.
  const units = [luma, chroma, chroma, luma], vivid = (v, k) => abs(v * units[k]) > 8.000001
  const logs = (major, minor, angle) => {
    if (!range) return [0, 0]
    const r = power((major - minor) * delta), s = sin(PI * angle / angles[major - minor])
    const lift = log2(1 + (r * r - 1) * s * s) / 2, fixed = -2 - position / 4 - 1 / 64 + .5
    return [major * delta - lift, minor * delta + lift].map(e => clamp(floor(e + fixed), finest, coarsest) - finest)
  }
  const coder = rangeDecoder(bytes, at, end)

  const palette = slots(coder, 144, 60)
  const background = array(channels, k => {
    const bit = node => palette.bit(72 * min(k, 1) + node)
    if (bit(0)) return 0
    const negative = bit(1)
    let length = 0, m = 1
    while (length < 16 && bit(2 + length)) length++
    if (length > 0) m = 2 + bit(20 + 3 * length)
    if (length > 1) m = 2 * m + bit(21 + 3 * length + (m & 1))
    if (length > 2) m = m * power(length - 2) + coder.raw(length - 2)
    m = negative ? -m : m
    return vivid(m, k) ? broken("background") : m
  })

  // Positions (spec §8.4): squares as [log of the side, x, y].
  const area = (BigInt(256 * grid[0]) * BigInt(grid[1]) / BigInt(max(1, count)) || 1n).toString(2)
  const cells = floor((16 * (area.length - 1) + parseInt((area + "0000").slice(1, 5), 2) - 128) / 2)
  const squares = [], halving = gains(32), stay = slots(coder, 72, 250)
  stayChances.forEach((chance, i) => {
    let none = 65536
    for (let n = 0; n < 3; n++) {
      none = none * (256 - chance) >> 8
      stay.all[3 * i + n] = [64 * clamp(65536 - none, 256, 65280), 6]
    }
  })
  const stays = (log, n) => stay.bit(3 * clamp(trunc((16 * log - cells) / 8) + 12, 0, 23) + min(n, 3) - 1)
  const lower = (n, [in0, in1]) => {
    const part = floor(in0 * 65536 / (in0 + in1))
    if (n <= 12) {
      let chances = [65536, ...Array(n).fill(0)]
      for (let i = 0; i < n; i++) chances = chances.map((c, k) => floor((c * (65536 - part) + (k ? chances[k - 1] * part : 0)) / 65536))
      const sums = [0]
      for (const chance of chances) sums.push(sums.at(-1) + chance + 1)
      return coder.choose(k => sums[k], 0, n + 1)[0]
    }
    const fine = max(0, ilog2(n) - 10), classes = [ilog2(n)]
    const values = near(coder, floor(floor(16 * n * part / 65536) / power(fine)), max(0, (log16(n) >> 1) - 16 * fine) + 120 + halving.sum(classes))
    const coarse = values.bounded(0, (n >> fine) + 1, 64)[0], v = coarse * power(fine)
    halving.learn(classes, values.distance(coarse))
    const result = v + coder.raw(fine)
    return result > n ? broken("tree of positions") : result
  }
  const region = (corner, log, n) => {
    if (n == 1) {
      let l = min(...log, range)
      while (l > 0 && !stays(l, 1)) l--
      const place = coder.pair(log[0] - l, log[1] - l).map((v, k) => corner[k] + v * power(l))
      if (place.some((v, k) => v >= grid[k])) broken("position")
      squares.push([l, ...place])
      return
    }
    if (log[0] == log[1] && log[0] <= range)
      while (n > 0 && (!log[0] || stays(log[0], n))) {
        n--
        squares.push([log[0], ...corner])
      }
    if (!n) return
    const axis = log[0] >= log[1] ? 0 : 1, half = [...log], upper = [...corner]
    half[axis]--
    upper[axis] += power(half[axis])
    const inside = [corner, upper].map(c => clamp(grid[axis] - c[axis], 0, power(half[axis])))
    const first = inside[1] > 0 ? lower(n, inside) : n
    if (first) region(corner, half, first)
    if (first < n) region(upper, half, n - first)
  }
  if (count) region([0, 0], grid.map(g => max(bits(g - 1), range)), count)
  squares.sort((a, b) => b[0] - a[0])

  // Neighbours (spec §8.5).
  const buckets = [0, 0], sums = new Map
  const last = () => grid.map((g, k) => ceil(g / power(buckets[k])) - 1)
  while ((last()[0] + 1) * (last()[1] + 1) > max(1, floor(3 * count / 8)) && buckets[1] < 30) buckets[buckets[0] == buckets[1] ? 0 : 1]++
  const ends = last(), key = (x, y) => y * 2 ** 30 + x
  const spot = square => [0, 1].map(k => {
    const u = floor((square[k + 1] + (1 << square[0] >> 1)) * 8 / power(buckets[k])), c = floor(u / 8)
    return c <= ends[k] ? [c, u - 8 * c] : [ends[k], 7]
  })
  const around = ([[cx, fx], [cy, fy]]) => {
    const total = Array(14).fill(0)
    for (let y = max(0, cy - 1); y <= min(ends[1], cy + 1); y++)
      for (let x = max(0, cx - 1); x <= min(ends[0], cx + 1); x++) {
        const dx = 8 * (x - cx) + 4 - fx, dy = 8 * (y - cy) + 4 - fy
        const weight = power(ilog2(5792 / (dx * dx + dy * dy + 10) | 0))
        sums.get(key(x, y))?.forEach((v, i) => total[i] += weight * v)
      }
    return total
  }

  // Shape and colour (spec §8.6).
  const spacing = trunc((cells + 16 * finest + 32) * 32 / Delta), octave = trunc(512 / Delta)
  const running = start => ({ sum: 4 * start, count: 4, value: start })
  const means = [spacing - octave, spacing - 3 * octave, ...array(4, k => 16 * (background[k] || 0))].map(running)
  const errors = [384, 192, 128, 384].map(running)
  const slope = xy => ({ xy, xx: 1048576, value: 0 })
  const follow = array(4, () => slope(1048576)), cross = array(4, () => [slope(0), slope(0)]), slopes = [...follow, ...cross.flat()]
  const times = (s, v) => floor(s.value * v / 256)
  const add = (s, u, v) => {
    s.xy += u * v
    s.xx += u * u
    if (max(s.xx, abs(s.xy)) >= power(50)) { s.xy = floor(s.xy / 2); s.xx = floor(s.xx / 2) }
  }
  const seats = new Map
  for (let major = 0; major <= top; major++) {
    const seat = clamp(floor((2 * (major * Delta - 64 - 8 * position) + 31) / 64), finest, coarsest) - finest
    seats.set(seat, [...seats.get(seat) || [], major])
  }
  const minorGains = gains(40, 9, 9), angleGains = gains(8, 6, 16), colorGains = background.map(() => gains(16, 9, 8))
  const shift = Array(40).fill(0), seen = Array(40).fill(0), within = (v, c) => clamp(v, -c, c) + c
  const colour = integers => {
    const c = integers.map((v, k) => v * units[k]), [Y, co, cg] = c
    return channels > 2 ? [Y - cg / 2 + co / 2, Y + cg / 2, Y - cg / 2 - co / 2, ...c.slice(3)] : c
  }
  let before = []
  const gaussians = squares.map((square, index) => {
    const here = spot(square), total = around(here), l = square[0], weight = total[13]
    if (index < 64 || index % 8 == 0) {
      for (const m of [...means, ...errors]) m.value = floor(m.sum / m.count)
      // Products above 2⁵³ need more than a double.
      for (const s of slopes) s.value = clamp(s.xx < power(40) ? trunc(s.xy * 256 / s.xx) : Number(BigInt(s.xy) * 256n / BigInt(s.xx)), -1024, 1024)
    }
    const mean = means.map(m => m.value), trust = d => floor(16777216 / (weight + d))
    const dev = mean.map((m, k) => floor((16 * total[k] - m * weight) * trust(40) / 16777216))
    const seat = seats.get(l) || broken("square without a scale")
    const major = near(coder, mean[0] + dev[0], 165).bounded(seat[0], seat.length, 1024)[0]

    const e = 16 * major - mean[1] - trunc((9 * (16 * major - mean[0]) + 10 * dev[1]) / 16)
    const kind = clamp(e + 8 >> 4, 0, 39), expected = e + (shift[kind] >> 16)
    const minorClasses = [kind, within(dev[0] >> 5, 4), within(dev[1] >> 5, 4)]
    const aspects = near(coder, expected, 152 + minorGains.sum(minorClasses)), d = aspects.bounded(0, major + 1, 1024)[0]
    minorGains.learn(minorClasses, aspects.distance(d))
    shift[kind] = clamp(shift[kind] + clamp(16 * d - expected, -64, 64) * max(1024, floor(65536 / (seen[kind]++ + 20))), -8388608, 8388608)
    const minor = major - d

    const n = angles[d]
    let angle = 0
    if (n > 1) {
      let x = floor(total[10] / 256), y = floor(total[11] / 256), direction = 0, accord = 0
      const S = x * x + y * y, long = total[12]
      if (long) accord = 1 + [1, 2, 3, 4].filter(k => 25 * S >= k * k * long * long).length
      if (accord > 1) {
        let quarter = 3
        if (x > 0 && y >= 0) quarter = 0
        else if (x <= 0 && y > 0) { quarter = 1; [x, y] = [y, -x] }
        else if (x < 0) { quarter = 2; [x, y] = [-x, -y] }
        else [x, y] = [-y, x]
        direction = (16 * quarter + tangents.filter(t => 4096 * y >= x * t).length) % 64
      }
      const p = floor(direction * n / 4), classes = [min(7, log16(n) >> 4), accord, direction >> 2]
      const [v, from, to, all] = near(coder, p, log16(n) + angleGains.sum(classes) + accordLogs[accord]).bounded(p - 8 * n + 15 >> 4, n, 16384)
      angle = (v % n + n) % n
      angleGains.learn(classes, floor(11356 * abs(from + to - all) / all))
    }

    const step = logs(major, minor, angle), rest = coder.pair(l - step[0], l - step[1])
    const place = rest.map((v, k) => floor(square[k + 1] / power(step[k])) + v)
    if (place.some((v, k) => v >= ceil(size[k] / power(finest + step[k])))) broken("position")

    const integers = [], surprise = [], off = [0, 0, 0, 0]
    const z = clamp(trunc((major + minor - (spacing >> 3)) * Delta / 32) + 8, 0, 15), a = min(7, d * Delta >> 5)
    let apart = 8
    for (let k = 0; k < channels; k++) {
      const F = times(follow[k], dev[2 + k]), known = cross[k].slice(0, surprise.length)
      const p = clamp(known.reduce((sum, s, j) => sum + times(s, surprise[j]), mean[2 + k] + F), -524288, 524272)
      const error = floor((16 * total[6 + k] + 512 * errors[k].value) * trust(512) / 16777216), classes = [z, apart, a]
      const values = near(coder, p, log16(max(1, error)) + 32 + colorGains[k].sum(classes)), v = values.open()
      if (vivid(v, k)) broken("colour")
      integers.push(v)
      colorGains[k].learn(classes, values.distance(v))
      off[k] = min(65536, abs(16 * v - p) >> 2)
      apart = min(7, bits(abs(v - (p + 8 >> 4))))
      const more = 16 * v - mean[2 + k]
      add(follow[k], dev[2 + k], more)
      let left = more - F
      surprise.push(left)
      known.forEach((s, j) => {
        add(s, surprise[j], left)
        left -= times(s, surprise[j])
      })
    }

    const values = array(6, k => [major, minor, ...integers][k] || 0)
    means.forEach((m, k) => { m.sum += 16 * values[k]; m.count++ })
    errors.forEach((m, k) => { m.sum += 16 * off[k]; m.count++ })
    const long = floor(16 * d * Delta / (d * Delta + 32)), axis = directions[floor((64 * angle + (n >> 1)) / n) & 63].map(v => long * v)
    const at = key(here[0][0], here[1][0]), old = sums.get(at)
    const sum = [...values, ...off, ...axis, long, 1].map((v, k) => v + (old ? old[k] : 0))
    sums.set(at, sum[13] >= 16 ? sum.map(v => floor(v / 2)) : sum)

    // Gaussians of one square ascend.
    const row = [...square, major, minor, angle, ...place, ...integers], first = row.findIndex((v, k) => v != before[k])
    if (first > 2 && row[first] < before[first]) broken("order of the Gaussians")
    before = row
    return [(place[0] + .5) * power(finest + step[0]), (place[1] + .5) * power(finest + step[1]), power(major * delta - 2), power(minor * delta - 2), PI * angle / n, colour(integers)]
  })
  coder.finish()
  return { width: size[0], height: size[1], channels, blend: flags & 4 ? "sum" : "normalized", background: colour(background), gaussians }
}

// Renders at the size of the picture or at the given size. In a smaller picture, Gaussians are widened by the area of a pixel.
export function decode(bytes, width, height) {
  const picture = read(bytes), { channels, background } = picture
  // If the file determines a side, the picture may be a strip with a million rows.
  const most = power(width && height ? 24 : 20)
  width ??= picture.width
  height ??= max(1, round(picture.height * width / picture.width))
  if (![width, height].every(v => Number.isInteger(v) && v > 0)) stop("parameter", `size is ${width} × ${height}, not two integers of at least 1`)
  if (width * height > most) stop("limit", `size is ${width * height}, at most ${most} is allowed`)
  const stride = channels + 1, sums = new Float64Array(width * height * stride), edge = exp(-6.125)
  const dx = picture.width / width, dy = picture.height / height, wider = [dx, dy].map(d => max(0, d * d - 1) / 12)
  const drawn = picture.gaussians.map(([cx, cy, s, t, phi, color]) => {
    const c = cos(phi), n = sin(phi), xx = s * s * c * c + t * t * n * n + wider[0], yy = s * s * n * n + t * t * c * c + wider[1], xy = (s * s - t * t) * c * n
    const det = xx * yy - xy * xy, [rx, ry] = [3.5 * Math.sqrt(xx), 3.5 * Math.sqrt(yy)]
    const box = [max(0, floor((cx - rx) / dx)), min(width, ceil((cx + rx) / dx)), max(0, floor((cy - ry) / dy)), min(height, ceil((cy + ry) / dy))]
    // The determinant of a thin Gaussian would lose all its digits. If nothing was widened, it is the product of the deviations.
    const sure = wider[0] + wider[1] ? det : s * s * t * t
    return [cx, cy, color, box, yy / sure, -xy / sure, xx / sure, s * t / Math.sqrt(sure)]
  })
  const work = drawn.reduce((sum, g) => sum + max(0, g[3][1] - g[3][0]) * max(0, g[3][3] - g[3][2]), 0)
  if (work > power(28)) stop("limit", `work is ${work}, at most ${power(28)} is allowed`)
  for (const [cx, cy, color, [x0, x1, y0, y1], A, B, C, share] of drawn)
    for (let j = y0; j < y1; j++)
      for (let i = x0; i < x1; i++) {
        const x = (i + .5) * dx - cx, y = (j + .5) * dy - cy, w = share * (exp(-(A * x * x + 2 * B * x * y + C * y * y) / 2) - edge)
        if (w > 0) {
          const o = (j * width + i) * stride
          for (let k = 0; k < channels; k++) sums[o + k] += w * color[k]
          sums[o + channels] += w
        }
      }
  const rgba = new Uint8ClampedArray(width * height * 4)
  for (let i = 0; i < width * height; i++) {
    const v = background.map((b, k) => {
      const s = sums[i * stride + k]
      return floor(255 * clamp(picture.blend == "sum" ? b + s : (s + b / 128) / (sums[i * stride + channels] + 1 / 128), 0, 1) + .5)
    })
    rgba.set(channels < 3 ? [v[0], v[0], v[0], v[1] ?? 255] : [v[0], v[1], v[2], v[3] ?? 255], 4 * i)
  }
  return { width, height, rgba, picture }
}
