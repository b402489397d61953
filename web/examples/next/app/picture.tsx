"use client"
// The element as a component. Its style reserves the space until the script has loaded. The element may add its role and its label before
// React hydrates it; this is not a mismatch.
import "ssplat/ssplat-img.js"

type Properties = { src: string, width: number, height: number, placeholder: string, alt: string }

export function Picture({ width, height, ...others }: Properties) {
  const style = { display: "inline-block", width, maxWidth: "100%", height: "auto", aspectRatio: `${width} / ${height}` }
  return <ssplat-img {...others} style={style} suppressHydrationWarning />
}
