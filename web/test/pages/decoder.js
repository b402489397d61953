// Tests the decoder in a page: on the page's thread, and in a worker.
import { Decoder } from "/web/dist/ssplat.js"
import { run } from "/web/test/files.js"

export async function test(cases) {
  const load = async path => new Uint8Array(await (await fetch(`/spec/vectors/${path}`)).arrayBuffer())
  const problems = [], words = []
  for (const worker of [false, true]) {
    const decoder = new Decoder({ worker }), answer = await run(cases, load, decoder)
    problems.push(...answer.problems.map(p => worker ? `worker: ${p}` : p))
    words.push(answer.words)
    const image = await decoder.decode(await load(cases[0].path))
    if (!(image instanceof ImageData)) problems.push(`${image} is not ImageData`)
    // A picture reuses the memory of another one if it is large enough, and allocates memory otherwise.
    const [expected, ...others] = await Promise.all([0, 0, 0].map(async () => decoder.decode(await load(cases[0].path))))
    for (const [into, fits] of [[others[0].data.buffer, true], [others[1].data.buffer.slice(1), false]]) {
      const size = into.byteLength, again = await decoder.decode(await load(cases[0].path), { into })
      if (again.data.length != expected.data.length || !again.data.every((v, i) => v == expected.data[i])) problems.push(`other samples in ${size} bytes of memory`)
      if (fits ? again.data.buffer.byteLength != size : again.data.buffer == into) problems.push(`memory of ${size} bytes`)
      if (fits && (worker ? into.byteLength > 0 : again.data.buffer != into)) problems.push("the memory is not taken")
    }
    if ((await decoder.decode(await load(cases[0].path), { into: 7 }).catch(e => e)).kind != "parameter") problems.push("7 is taken for memory")
    decoder.close()
    if ((await decoder.decode(await load(cases[0].path)).catch(e => e)).kind != "internal") problems.push("a closed decoder answers")
  }
  try {
    new Decoder({ wroker: true })
    problems.push("an option that there is not is taken")
  } catch ({ kind, message }) {
    if (kind != "parameter" || !message.includes("wroker")) problems.push(`${kind}: ${message}`)
  }
  const nowhere = await new Decoder({ module: "/web/no-such-file.wasm", worker: true }).decode(await load(cases[0].path)).catch(e => e)
  if (nowhere.kind != "network" || !nowhere.message.includes("404")) problems.push(`a module that is not there: ${nowhere.kind}, ${nowhere.message}`)
  return { problems, words: words.join("; in a worker ") }
}
