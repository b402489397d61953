// The least time of many decodings.
export async function measure(decoder, files) {
  const lines = []
  for (const [name, base64] of files) {
    const bytes = Uint8Array.from(atob(base64), c => c.charCodeAt(0))
    for (const width of [undefined, 64]) {
      let least = Infinity
      for (let i = 0; i < (width ? 300 : 60); i++) {
        const start = performance.now()
        await decoder.decode(bytes, { width })
        least = Math.min(least, performance.now() - start)
      }
      lines.push(`${name}, ${bytes.length} bytes, ${width ? `${width} wide` : "own size"}: ${least.toFixed(2)} ms`)
    }
  }
  return lines
}

export async function test(files) {
  const { Decoder } = await import("/web/dist/ssplat.js")
  return { lines: await measure(new Decoder, files) }
}
