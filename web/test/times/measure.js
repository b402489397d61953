// Measures the minimum and the median time of many decodes.
export async function measure(decoder, files) {
  const lines = []
  for (const [name, base64] of files) {
    const bytes = Uint8Array.from(atob(base64), c => c.charCodeAt(0))
    for (const [width, again, words] of [[undefined, false, "own size"], [undefined, true, "own size into the memory of the last"], [64, false, "64 wide"]]) {
      // Browsers measure tenths of a millisecond, so several decodes are timed together.
      const times = [], each = bytes.length < 1000 ? 5 : 1
      let into
      for (let i = 0; i < 200; i++) {
        const start = performance.now()
        for (let k = 0; k < each; k++) {
          const { data } = await decoder.decode(bytes, { width, into })
          if (again) into = data.buffer
        }
        times.push((performance.now() - start) / each)
      }
      times.sort((a, b) => a - b)
      lines.push(`${name}, ${bytes.length} bytes, ${words}: ${times[0].toFixed(2)} ms at the least, ${times[times.length >> 1].toFixed(2)} in the middle`)
    }
  }
  return lines
}

export async function test(files) {
  const { Decoder } = await import("/web/dist/ssplat.js")
  return { lines: await measure(new Decoder, files) }
}
