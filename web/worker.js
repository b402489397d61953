// A machine in a thread of its own: questions in, answers out.
import { Machine, compile } from "./machine.js"

let machine
onmessage = async ({ data: { id, source, question, bytes, options } }) => {
  try {
    if (question == "start") return machine = compile(source).then(module => new Machine(module))
    const answer = (await machine)[question](bytes, options)
    const buffers = Object.values(answer).filter(ArrayBuffer.isView).map(v => v.buffer)
    postMessage({ id, answer }, { transfer: [...new Set(buffers)] })
  } catch ({ kind = "internal", message }) {
    postMessage({ id, kind, message })
  }
}
