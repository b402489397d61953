// Worker for one job, in browsers and in Node.js. It receives a job, and sends the progress and the result.
import { run, score } from "./encode-machine.js"

// Node.js has a different interface to the parent thread.
const port = globalThis.process?.getBuiltinModule?.("node:worker_threads").parentPort ?? globalThis
const receive = ({ isWatched, ...task }) => {
  try {
    const answer = task.module ? run(task, (stage, done) => { if (isWatched) port.postMessage({ stage, done }) }) : score(task.scorer, task.job)
    port.postMessage({ answer }, answer.bytes ? [answer.bytes.buffer] : [])
  } catch ({ kind = "internal", message }) {
    port.postMessage({ kind, message })
  }
}
if (port == globalThis) onmessage = ({ data }) => receive(data)
else port.once("message", receive)
