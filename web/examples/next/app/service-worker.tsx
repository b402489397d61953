"use client"
// Installs the service worker, which lets <img> show .ssplat files.
import { useEffect } from "react"
import { registerSsplat } from "ssplat/register"

export function ServiceWorker() {
  useEffect(() => void registerSsplat(), [])
  return null
}
