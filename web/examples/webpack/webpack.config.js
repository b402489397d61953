import { ServiceWorkerPlugin } from "ssplat/webpack"

export default {
  mode: "production",
  entry: "./main.js",
  output: { path: `${import.meta.dirname}/dist`, clean: true },
  plugins: [new ServiceWorkerPlugin()],
  performance: { hints: false },
  module: {
    rules: [{ resourceQuery: /[?&]ssplat(&|$)/, type: "javascript/auto", loader: "ssplat/webpack", options: { effort: 1 } }],
  },
}
