// The decoder in a page: on the page's thread, and in a worker.
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
    decoder.close()
    if ((await decoder.decode(await load(cases[0].path)).catch(e => e)).kind != "internal") problems.push("a closed decoder answers")
  }
  return { problems, words: words.join("; in a worker ") }
}
