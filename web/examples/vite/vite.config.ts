import ssplat from "ssplat/vite"
import { defineConfig } from "vite"

export default defineConfig({ base: "./", plugins: [ssplat({ effort: 1 })] })
