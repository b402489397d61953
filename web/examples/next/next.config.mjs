import { withSsplat } from "ssplat/next"

export default withSsplat({ output: "export", turbopack: { root: import.meta.dirname } }, { effort: 1, serviceWorker: true })
