// Every module with and without `.js`.
/// <reference types="ssplat/client" />
import { Decoder } from "ssplat"
import { Decoder as SameDecoder } from "ssplat/ssplat.js"
import { encode } from "ssplat/encode"
import { encode as sameEncode } from "ssplat/encode.js"
import { encodeFile } from "ssplat/node.js"
import { decode } from "ssplat/placeholder"
import { registerSsplat } from "ssplat/register"
import { SsplatImg } from "ssplat/ssplat-img"
import ssplat from "ssplat/vite.js"
import { withSsplat } from "ssplat/next.js"
import { ServiceWorkerPlugin } from "ssplat/webpack.js"

export const isControlled: Promise<boolean> = registerSsplat({ url: "/worker.js", scope: "/", registration: navigator.serviceWorker.ready })
// @ts-expect-error
registerSsplat({ path: "/" })
export default [Decoder, SameDecoder, encode, sameEncode, encodeFile, decode, SsplatImg, ssplat(), withSsplat({}, { serviceWorker: true }), new ServiceWorkerPlugin()]
