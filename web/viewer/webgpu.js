// Renders Gaussians with WebGPU if it can blend 32-bit floats, as splatting.js does with WebGL2.
import { Scene, K, cut, epsilon, growth } from "./scene.js"

// Maximum time to wait for answers of the system.
const patience = 3000

// Formats a number for WGSL, where "1" is an integer.
const float = v => v.toExponential(9) + "f"

const shared = `
struct View { corner: vec2f, size: vec2f, sides: vec2f, pace: f32, growth: f32, ground: vec4f }
@group(0) @binding(0) var<uniform> view: View;
`

const splats = alpha => `${shared}
struct Splat {
  @builtin(position) position: vec4f,
  @location(0) @interpolate(flat) centre: vec2f,
  @location(1) @interpolate(flat) axes: vec4f,
  @location(2) @interpolate(flat) colour: vec4f,
  @location(3) @interpolate(flat) peak: f32,
}
@vertex fn place(@builtin(vertex_index) number: u32, @location(0) mean: vec2f, @location(1) scale: vec2f, @location(2) axis: vec2f, @location(3) colour: vec4f) -> Splat {
  var s = scale;
  var major = axis;
  var peak = 1f;
  if (view.growth > 0) {
    // The axes of the covariance with the growth of both variances. Its determinant is a sum of positive terms.
    let v = s * s;
    let square = axis * axis;
    let xx = v.x * square.x + v.y * square.y;
    let yy = v.x * square.y + v.y * square.x;
    let xy = (v.x - v.y) * axis.x * axis.y;
    let det = v.x * v.y + view.growth * (xx + yy) + view.growth * view.growth;
    let away = xx - yy;
    let spread = length(vec2f(away, 2 * xy));
    let large = .5 * (xx + yy + spread) + view.growth;
    s = sqrt(vec2f(large, det / large));
    peak = sqrt(v.x * v.y / det);
    // Half of the angle whose cosine and sine are away / spread and 2 xy / spread.
    if (spread > 0) {
      let longer = sqrt(.5 + .5 * abs(away) / spread);
      let shorter = xy / spread / longer;
      major = select(vec2f(abs(shorter), select(longer, -longer, shorter < 0)), vec2f(longer, shorter), away > 0);
    }
  }
  let minor = vec2f(-major.y, major.x);
  let centre = (mean - view.corner) / view.pace;
  // One more pixel on each side, because corners are rounded to fractions of a pixel.
  let reach = ${float(K)} * s / view.pace + 1;
  let at = vec2f(f32(number & 1), f32(number >> 1)) * 2 - 1;
  let place = (centre + at.x * reach.x * major + at.y * reach.y * minor) / view.size * 2 - 1;
  return Splat(vec4f(place.x, -place.y, 0, 1), centre, vec4f(major * view.pace / s.x, minor * view.pace / s.y), colour, peak);
}
struct Sums { @location(0) sums: vec4f, ${alpha ? "@location(1) alphas: f32," : ""} }
@fragment fn weigh(splat: Splat) -> Sums {
  let away = splat.position.xy - splat.centre;
  let u = dot(away, splat.axes.xy);
  let v = dot(away, splat.axes.zw);
  let w = splat.peak * max(0, exp(-.5 * (u * u + v * v)) - ${float(cut)});
  return Sums(vec4f(w * splat.colour.rgb, w), ${alpha ? "w * splat.colour.a" : ""});
}`

const samples = ({ alpha, normalized }) => `${shared}
@group(0) @binding(1) var sums: texture_2d<f32>;
${alpha ? "@group(0) @binding(2) var alphas: texture_2d<f32>;" : ""}
// Canvases store premultiplied colours.
override premultiplied: bool;
@vertex fn place(@builtin(vertex_index) number: u32) -> @builtin(position) vec4f {
  return vec4f(vec2f(f32(number & 1), f32(number >> 1)) * 4 - 1, 0, 1);
}
@fragment fn shade(@builtin(position) position: vec4f) -> @location(0) vec4f {
  let at = vec2i(position.xy);
  let place = view.corner + (vec2f(at) + .5) * view.pace;
  if (any(place < vec2f(0)) || any(place > view.sides)) { return vec4f(0); }
  let sum = textureLoad(sums, at, 0);
  var v = vec4f(sum.rgb, ${alpha ? "textureLoad(alphas, at, 0).x" : "0"});
  v = ${normalized ? `(v + ${float(epsilon)} * view.ground) / (sum.a + ${float(epsilon)})` : "view.ground + v"};
  v = floor(clamp(v, vec4f(0), vec4f(1)) * 255 + .5) / 255;
  ${alpha ? "if (premultiplied) { v = vec4f(v.rgb * v.a, v.a); }" : "v.a = 1;"}
  return v;
}`

const straight = "rgba8unorm"

export class WebGpuSplatting {
  name = "WebGPU"
  lost = false
  // Called when the device is lost.
  onlost
  #device
  #context
  #format
  #scene
  #buffers = []
  #view
  #weigh
  #shade
  #textures = []
  #size = []

  // Returns nothing if no device can blend 32-bit floats. A software device, which is slower than WebGL2, is used only if `asked`.
  static async create(asked = false) {
    const late = new Promise(resolve => setTimeout(resolve, patience)), feature = "float32-blendable"
    const adapter = await Promise.race([navigator.gpu?.requestAdapter(), late]).catch(() => {})
    if (!adapter?.features.has(feature) || adapter.info?.isFallbackAdapter && !asked) return
    const device = await Promise.race([adapter.requestDevice({ requiredFeatures: [feature] }), late]).catch(() => {})
    const canvas = new OffscreenCanvas(1, 1), context = canvas.getContext("webgpu")
    return device && context ? new WebGpuSplatting(device, canvas, context) : undefined
  }

  constructor(device, canvas, context) {
    this.#device = device
    this.canvas = canvas
    this.#context = context
    this.#format = navigator.gpu.getPreferredCanvasFormat()
    this.#view = device.createBuffer({ size: 48, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST })
    // A device that is lost or reports an error renders nothing.
    device.lost.then(({ message }) => this.#lose(message))
    device.onuncapturederror = ({ error }) => this.#lose(error.message)
  }

  #lose(words) {
    if (this.lost) return
    this.lost = true
    console.error(`WebGPU: ${words}`)
    this.onlost?.()
  }

  // Sets the Gaussians of a file, as returned by `gaussians`, the blend from `info`, and the colour space of the canvas.
  load(all, blend, colorSpace = "srgb") {
    const device = this.#device, scene = this.#scene = new Scene(all, blend)
    this.#buffers.forEach(b => b.destroy())
    const arrays = [scene.mean, scene.scale, scene.axis, scene.color]
    this.#buffers = arrays.map(values => {
      const buffer = device.createBuffer({ size: Math.max(16, values.byteLength), usage: GPUBufferUsage.VERTEX | GPUBufferUsage.COPY_DST })
      device.queue.writeBuffer(buffer, 0, values)
      return buffer
    })
    const code = device.createShaderModule({ code: splats(scene.alpha) }), add = { srcFactor: "one", dstFactor: "one" }
    this.#weigh = device.createRenderPipeline({
      layout: "auto",
      vertex: { module: code, buffers: [2, 2, 2, 4].map((n, k) => ({ arrayStride: 4 * n, stepMode: "instance", attributes: [{ shaderLocation: k, offset: 0, format: `float32x${n}` }] })) },
      primitive: { topology: "triangle-strip" },
      fragment: { module: code, targets: this.#targets().map(format => ({ format, blend: { color: add, alpha: add } })) },
    })
    const shading = device.createShaderModule({ code: samples(scene) })
    this.#shade = [this.#format, straight].map((format, k) => device.createRenderPipeline({
      layout: "auto",
      vertex: { module: shading },
      fragment: { module: shading, targets: [{ format }], constants: scene.alpha ? { premultiplied: k == 0 ? 1 : 0 } : {} },
    }))
    this.#context.configure({ device, format: this.#format, alphaMode: "premultiplied", colorSpace })
    this.#size = []
  }

  // Formats of the sums: colours and weights, and alpha if there is any.
  #targets() {
    return this.#scene.alpha ? ["rgba32float", "r32float"] : ["rgba32float"]
  }

  // Returns whether a view can be rendered. One pixel of the canvas is `step` pixels of the picture; the corner of the canvas is at (left,
  // top).
  can(view) {
    return !!this.#scene && !this.lost && this.#scene.allows(view, this.#device.limits.maxTextureDimension2D)
  }

  #resize(width, height) {
    if (this.#size[0] == width && this.#size[1] == height) return
    ;[this.canvas.width, this.canvas.height] = this.#size = [width, height]
    this.#textures.forEach(t => t.destroy())
    const usage = GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.TEXTURE_BINDING
    this.#textures = this.#targets().map(format => this.#device.createTexture({ size: [width, height], format, usage }))
  }

  #bind(pipeline, textures) {
    const resources = [{ buffer: this.#view }, ...textures.map(t => t.createView())]
    return this.#device.createBindGroup({ layout: pipeline.getBindGroupLayout(0), entries: resources.map((resource, binding) => ({ binding, resource })) })
  }

  #pass(encoder, textures, pipeline, inputs, draw) {
    const pass = encoder.beginRenderPass({ colorAttachments: textures.map(t => ({ view: t.createView(), loadOp: "clear", clearValue: [0, 0, 0, 0], storeOp: "store" })) })
    pass.setPipeline(pipeline)
    pass.setBindGroup(0, this.#bind(pipeline, inputs))
    draw(pass)
    pass.end()
  }

  // Renders a view, for which `can` returned true, to the canvas.
  draw({ left, top, step, width, height }) {
    const { count, sides, background } = this.#scene
    this.#resize(width, height)
    this.#device.queue.writeBuffer(this.#view, 0, Float32Array.of(left, top, width, height, ...sides, step, growth(step), ...background))
    const encoder = this.#device.createCommandEncoder()
    this.#pass(encoder, this.#textures, this.#weigh, [], pass => {
      this.#buffers.forEach((buffer, k) => pass.setVertexBuffer(k, buffer))
      pass.draw(4, count)
    })
    this.#pass(encoder, [this.#context.getCurrentTexture()], this.#shade[0], this.#textures, pass => pass.draw(3))
    this.#device.queue.submit([encoder.finish()])
  }

  // Returns the last rendered view as RGBA, top row first.
  async pixels() {
    const [width, height] = this.#size, device = this.#device, bytesPerRow = Math.ceil(4 * width / 256) * 256
    const texture = device.createTexture({ size: [width, height], format: straight, usage: GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC })
    const buffer = device.createBuffer({ size: bytesPerRow * height, usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ })
    const encoder = device.createCommandEncoder()
    this.#pass(encoder, [texture], this.#shade[1], this.#textures, pass => pass.draw(3))
    encoder.copyTextureToBuffer({ texture }, { buffer, bytesPerRow }, [width, height])
    device.queue.submit([encoder.finish()])
    await buffer.mapAsync(GPUMapMode.READ)
    const rows = new Uint8Array(buffer.getMappedRange()), rgba = new Uint8ClampedArray(4 * width * height)
    for (let y = 0; y < height; y++) rgba.set(rows.subarray(bytesPerRow * y, bytesPerRow * y + 4 * width), 4 * width * y)
    for (const each of [buffer, texture]) each.destroy()
    return rgba
  }
}
