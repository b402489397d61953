export default {
  mode: "production",
  entry: "./main.js",
  output: { path: `${import.meta.dirname}/dist`, clean: true },
  performance: { hints: false },
  module: {
    rules: [{ resourceQuery: /[?&]ssplat(&|$)/, type: "javascript/auto", loader: "ssplat/webpack", options: { effort: 1 } }],
  },
}
