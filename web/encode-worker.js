// One job in a thread of its own, in browsers and in Node.js: a job in; progress and the answer out.
import { run } from "./encode-machine.js"

// Node.js has its own way to talk to the thread that started this one.
const port = globalThis.process?.getBuiltinModule?.("node:worker_threads").parentPort ?? globalThis
const receive = ({ module, job, isWatched }) => {
  try {
    const answer = run(module, job, (stage, done) => { if (isWatched) port.postMessage({ stage, done }) })
    port.postMessage({ answer }, answer.bytes ? [answer.bytes.buffer] : [])
  } catch ({ kind = "internal", message }) {
    port.postMessage({ kind, message })
  }
}
if (port == globalThis) onmessage = ({ data }) => receive(data)
else port.once("message", receive)
