// A picture with a placeholder, and the same picture smaller, in the element and in <img>.
import photo from "./photo.jpg?maxSide=1024&ssplat"
import small from "./photo.jpg?maxSide=256&bytes=3000&placeholder=100&ssplat"
import { registerSsplat } from "ssplat/register"
import "ssplat/ssplat-img.js"

for (const picture of [photo, small]) document.body.append(Object.assign(document.createElement("ssplat-img"), picture, { alt: "A photograph" }))
document.body.append(Object.assign(new Image(small.width, small.height), { src: small.src, alt: "A photograph" }))
await registerSsplat({ url: "ssplat-service-worker.js" })
