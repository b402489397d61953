/// <reference types="ssplat/vue" />
import { h, type GlobalComponents } from "vue"

type Properties = InstanceType<GlobalComponents["ssplat-img"]>["$props"]
export const right: Properties = { src: "photo.ssplat", alt: "A lighthouse", loading: "lazy", id: "photo" }
// @ts-expect-error
export const wrongLoading: Properties = { loading: "early" }
export const rendered = h("ssplat-img", { src: "photo.ssplat" })
