/// <reference types="ssplat/svelte" />
import type { SvelteHTMLElements } from "svelte/elements"

type Properties = SvelteHTMLElements["ssplat-img"]
export const right: Properties = { src: "photo.ssplat", alt: "A lighthouse", loading: "lazy", id: "photo" }
// @ts-expect-error
export const wrongLoading: Properties = { loading: "early" }
