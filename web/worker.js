// Worker with a machine. It receives the module first, then requests, and sends the results.
import { Machine } from "./machine.js"

let machine
onmessage = ({ data: { id, module, question, bytes, options } }) => {
  try {
    if (module) {
      machine = new Machine(module)
      return postMessage({ ready: true })
    }
    const answer = machine[question](bytes, options)
    const buffers = Object.values(answer).filter(ArrayBuffer.isView).map(v => v.buffer)
    postMessage({ id, answer }, { transfer: [...new Set(buffers)] })
  } catch ({ kind = "internal", message }) {
    postMessage({ id, kind, message })
  }
}
