// Worker for one job, in browsers and in Node.js. It receives a job, and sends the progress and the result.
import { run } from "./encode-machine.js"

// Node.js has a different interface to the parent thread.
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
