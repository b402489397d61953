// A picture with edges, noise and gradients, for tests in Node.js and in browsers: samples of `channels` at a time.
export function generated(width, height, channels, depth) {
  let state = 1
  const random = () => (state = Math.imul(state, 1664525) + 1013904223 >>> 0) / 2 ** 32
  const data = new (depth == 8 ? Uint8Array : Uint16Array)(width * height * channels), top = 2 ** depth - 1
  for (let i = 0; i < data.length; i++) {
    const k = i % channels, x = (i - k) / channels % width / width, y = Math.floor(i / channels / width) / height
    data[i] = top * ((x * (k + 1) + y * (3 - k) / 2) % 1 * 0.9 + random() * 0.1)
  }
  return { width, height, channels, data }
}
