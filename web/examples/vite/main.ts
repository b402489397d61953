// A picture with a placeholder, and the same picture smaller.
import photo from "./photo.jpg?maxSide=1024&ssplat"
import small from "./photo.jpg?maxSide=256&bytes=3000&placeholder=100&ssplat"
import "ssplat/ssplat-img.js"

for (const picture of [photo, small]) document.body.append(Object.assign(document.createElement("ssplat-img"), picture, { alt: "A photograph" }))
