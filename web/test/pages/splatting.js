// Tests the viewer's rendering on the graphics device: the decoder's picture within 2 code values.
import { Decoder } from "/web/dist/ssplat.js"
import { Splatting } from "/web/dist/viewer/splatting.js"

export async function test(cases) {
  const device = Splatting.create()
  return device ? within(cases, device) : { problems: ["no WebGL2 with float blending"], words: "nothing drawn" }
}

// Requirements for every device.
export async function within(cases, device) {
  const problems = [], decoder = new Decoder
  let views = 0, left = 0, worst = 0
  const draw = async (path, bytes, [x, y, w, h], width, height, step) => {
    const view = { left: x, top: y, step, width, height }
    if (!device.can(view)) return left++
    // The device renders only Gaussians, not the detail layer.
    const expected = await decoder.decode(bytes, { region: [x, y, w, h], width, height, detail: "off" })
    device.draw(view)
    const pixels = await device.pixels()
    let most = 0
    pixels.forEach((v, i) => most = Math.max(most, Math.abs(v - expected.data[i])))
    if (!(most <= 2)) problems.push(`${path}, ${width} × ${height} of ${w} × ${h} at ${x}, ${y}: off by ${most}`)
    worst = Math.max(worst, most)
    views++
  }
  for (const { path } of cases.filter(c => /^(valid|reduced)\//.test(c.path))) {
    const bytes = new Uint8Array(await (await fetch(`/spec/vectors/${path}`)).arrayBuffer()), info = await decoder.info(bytes)
    device.load(await decoder.gaussians(bytes), info.blend)
    const { width, height } = info
    await draw(path, bytes, [0, 0, width, height], width, height, 1)
    // Enlarged: the middle. And a little reduced, where Gaussians grow; sides that are multiples keep both steps equal.
    const part = [width >> 2, height >> 2, Math.min(48, width - (width >> 2)), Math.min(48, height - (height >> 2))]
    await draw(path, bytes, part, 8 * part[2], 8 * part[3], 1 / 8)
    const whole = [0, 0, width - width % 4, height - height % 4]
    if (whole[2] && whole[3]) await draw(path, bytes, whole, whole[2] * 3 / 4, whole[3] * 3 / 4, 4 / 3)
  }
  if (views < 60) problems.push(`only ${views} views were drawn`)
  if (device.can({ left: 0, top: 0, step: 1.6, width: 8, height: 8 })) problems.push("a view is claimed whose pixels are several samples")
  return { problems, words: `${views} views by ${device.name}, at most ${worst} off, ${left} left to the decoder` }
}
