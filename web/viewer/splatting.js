// Renders Gaussians with WebGL2 and float blending to a canvas, according to sections 5.2 to 5.5 of the specification.
import { Scene, K, cut, epsilon, growth } from "./scene.js"

const vertices = `#version 300 es
precision highp float;
layout(location = 0) in vec2 mean;
layout(location = 1) in vec2 scale;
layout(location = 2) in vec2 axis;
layout(location = 3) in vec4 color;
uniform vec2 corner, size;
uniform float pace, growth;
flat out vec2 centre;
flat out vec4 axes;
flat out vec4 colour;
flat out float peak;
void main() {
  vec2 s = scale, major = axis;
  peak = 1.;
  if (growth > 0.) {
    // The axes of the covariance with the growth of both variances. Its determinant is a sum of positive terms.
    vec2 v = s * s, square = axis * axis;
    float xx = v.x * square.x + v.y * square.y, yy = v.x * square.y + v.y * square.x, xy = (v.x - v.y) * axis.x * axis.y;
    float det = v.x * v.y + growth * (xx + yy) + growth * growth;
    float away = xx - yy, spread = length(vec2(away, 2. * xy));
    float large = .5 * (xx + yy + spread) + growth;
    s = sqrt(vec2(large, det / large));
    peak = sqrt(v.x * v.y / det);
    // Half of the angle whose cosine and sine are away / spread and 2 xy / spread.
    if (spread > 0.) {
      float longer = sqrt(.5 + .5 * abs(away) / spread), shorter = xy / spread / longer;
      major = away > 0. ? vec2(longer, shorter) : vec2(abs(shorter), shorter < 0. ? -longer : longer);
    }
  }
  vec2 minor = vec2(-major.y, major.x);
  centre = (mean - corner) / pace;
  axes = vec4(major * pace / s.x, minor * pace / s.y);
  colour = color;
  // One more pixel on each side, because corners are rounded to fractions of a pixel.
  vec2 reach = ${K} * s / pace + 1., at = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2. - 1.;
  gl_Position = vec4((centre + at.x * reach.x * major + at.y * reach.y * minor) / size * 2. - 1., 0., 1.);
}`

const weights = alpha => `#version 300 es
precision highp float;
flat in vec2 centre;
flat in vec4 axes;
flat in vec4 colour;
flat in float peak;
layout(location = 0) out vec4 sums;
${alpha ? "layout(location = 1) out vec4 alphas;" : ""}
void main() {
  vec2 away = gl_FragCoord.xy - centre;
  float u = dot(away, axes.xy), v = dot(away, axes.zw), w = peak * max(0., exp(-.5 * (u * u + v * v)) - ${cut});
  sums = vec4(w * colour.rgb, w);
  ${alpha ? "alphas = vec4(w * colour.a);" : ""}
}`

const corners = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4. - 1., 0., 1.); }`

const samples = (alpha, normalized) => `#version 300 es
precision highp float;
uniform highp sampler2D sums, alphas;
uniform vec4 ground;
uniform vec2 corner, size, sides;
uniform float pace;
out vec4 sample_;
void main() {
  // The first row of the sums is the upper one.
  ivec2 at = ivec2(gl_FragCoord.x, size.y - gl_FragCoord.y);
  vec2 place = corner + (vec2(at) + .5) * pace;
  if (any(lessThan(place, vec2(0.))) || any(greaterThan(place, sides))) { sample_ = vec4(0.); return; }
  vec4 sum = texelFetch(sums, at, 0), v = vec4(sum.rgb, ${alpha ? "texelFetch(alphas, at, 0).x" : "0."});
  v = ${normalized ? `(v + ${epsilon} * ground) / (sum.a + ${epsilon})` : "ground + v"};
  sample_ = floor(clamp(v, 0., 1.) * 255. + .5) / 255.;
  ${alpha ? "" : "sample_.a = 1.;"}
}`

export class Splatting {
  name = "WebGL2"
  #gl
  #arrays
  #framebuffer
  #textures = []
  #size = []
  #splats
  #resolve
  #scene
  #buffers = []

  // Returns nothing if WebGL2 with float blending is not available.
  static create() {
    const canvas = new OffscreenCanvas(1, 1)
    const gl = canvas.getContext("webgl2", { premultipliedAlpha: false, preserveDrawingBuffer: true, antialias: false, depth: false })
    return gl?.getExtension("EXT_color_buffer_float") && gl.getExtension("EXT_float_blend") ? new Splatting(gl, canvas) : undefined
  }

  constructor(gl, canvas) {
    this.#gl = gl
    this.canvas = canvas
    this.#arrays = [gl.createVertexArray(), gl.createVertexArray()]
    this.#framebuffer = gl.createFramebuffer()
  }

  // A lost device renders nothing.
  get lost() { return this.#gl.isContextLost() }

  #program(vertex, fragment) {
    const gl = this.#gl, program = gl.createProgram()
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind)
      gl.shaderSource(shader, source)
      gl.compileShader(shader)
      gl.attachShader(program, shader)
      gl.deleteShader(shader)
    }
    gl.linkProgram(program)
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !this.lost) throw new Error(gl.getAttachedShaders(program).map(s => gl.getShaderInfoLog(s)).join() + gl.getProgramInfoLog(program))
    return program
  }

  // Sets the Gaussians of a file, as returned by `gaussians`, the blend from `info`, and the colour space of the canvas.
  load(all, blend, colorSpace = "srgb") {
    const gl = this.#gl, scene = this.#scene = new Scene(all, blend)
    for (const program of [this.#splats, this.#resolve]) gl.deleteProgram(program)
    this.#splats = this.#program(vertices, weights(scene.alpha))
    this.#resolve = this.#program(corners, samples(scene.alpha, scene.normalized))
    this.#buffers.forEach(b => gl.deleteBuffer(b))
    gl.bindVertexArray(this.#arrays[0])
    this.#buffers = [scene.mean, scene.scale, scene.axis, scene.color].map((values, place) => {
      const buffer = gl.createBuffer()
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer)
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW)
      gl.enableVertexAttribArray(place)
      gl.vertexAttribPointer(place, place == 3 ? 4 : 2, gl.FLOAT, false, 0, 0)
      gl.vertexAttribDivisor(place, 1)
      return buffer
    })
    if ("drawingBufferColorSpace" in gl) gl.drawingBufferColorSpace = colorSpace
    this.#size = []
  }

  // Returns whether a view can be rendered. One pixel of the canvas is `step` pixels of the picture; the corner of the canvas is at (left,
  // top).
  can(view) {
    return !!this.#scene && !this.lost && this.#scene.allows(view, this.#gl.getParameter(this.#gl.MAX_TEXTURE_SIZE))
  }

  #resize(width, height) {
    const gl = this.#gl
    if (this.#size[0] == width && this.#size[1] == height) return
    ;[this.canvas.width, this.canvas.height] = this.#size = [width, height]
    this.#textures.forEach(t => gl.deleteTexture(t))
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#framebuffer)
    const targets = [gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1].slice(0, this.#scene.alpha ? 2 : 1)
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT1, gl.TEXTURE_2D, null, 0)
    this.#textures = targets.map(target => {
      const texture = gl.createTexture()
      gl.bindTexture(gl.TEXTURE_2D, texture)
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, width, height)
      for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST)
      gl.framebufferTexture2D(gl.FRAMEBUFFER, target, gl.TEXTURE_2D, texture, 0)
      return texture
    })
    gl.drawBuffers(targets)
  }

  // Renders a view, for which `can` returned true, to the canvas.
  draw({ left, top, step, width, height }) {
    const gl = this.#gl, { count, sides, background } = this.#scene
    this.#resize(width, height)
    const use = program => {
      gl.useProgram(program)
      const place = name => gl.getUniformLocation(program, name)
      gl.uniform2f(place("corner"), left, top)
      gl.uniform2f(place("size"), width, height)
      gl.uniform1f(place("pace"), step)
      return place
    }
    gl.viewport(0, 0, width, height)
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#framebuffer)
    gl.clearColor(0, 0, 0, 0)
    gl.clear(gl.COLOR_BUFFER_BIT)
    gl.enable(gl.BLEND)
    gl.blendFunc(gl.ONE, gl.ONE)
    const splat = use(this.#splats)
    gl.uniform1f(splat("growth"), growth(step))
    gl.bindVertexArray(this.#arrays[0])
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count)
    gl.disable(gl.BLEND)
    gl.bindFramebuffer(gl.FRAMEBUFFER, null)
    const place = use(this.#resolve)
    gl.uniform4fv(place("ground"), background)
    gl.uniform2f(place("sides"), ...sides)
    this.#textures.forEach((texture, k) => {
      gl.activeTexture(gl.TEXTURE0 + k)
      gl.bindTexture(gl.TEXTURE_2D, texture)
      gl.uniform1i(place(["sums", "alphas"][k]), k)
    })
    gl.activeTexture(gl.TEXTURE0)
    gl.bindVertexArray(this.#arrays[1])
    gl.drawArrays(gl.TRIANGLES, 0, 3)
  }

  // Returns the last rendered view as RGBA, top row first.
  pixels() {
    const [width, height] = this.#size, gl = this.#gl, upside = new Uint8Array(4 * width * height), rgba = new Uint8ClampedArray(upside.length)
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, upside)
    for (let y = 0; y < height; y++) rgba.set(upside.subarray(4 * width * y, 4 * width * (y + 1)), 4 * width * (height - 1 - y))
    return rgba
  }
}
