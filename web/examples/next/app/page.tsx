// A picture with a placeholder, and the same picture smaller, in the element and in <img>.
import photo from "../photo.jpg?maxSide=1024&ssplat"
import small from "../photo.jpg?maxSide=256&bytes=3000&placeholder=100&ssplat"
import { Picture } from "./picture"
import { ServiceWorker } from "./service-worker"

export default function Page() {
  return <>
    {[photo, small].map(picture => <Picture key={picture.src} {...picture} alt="A photograph" />)}
    <img src={small.src} width={small.width} height={small.height} alt="A photograph" />
    <ServiceWorker />
  </>
}
