export interface RegisterOptions {
  /** The script of the service worker; by default `ssplat-service-worker.js` in the base folder of the site. */
  url?: string | URL
  /** The folder whose pages the worker serves; by default that of the script. */
  scope?: string
  /** The URL of the WebAssembly, if it is not that of the package. */
  module?: string | URL
  /** The registration of a service worker of your own that loads the script with `importScripts`. */
  registration?: ServiceWorkerRegistration | Promise<ServiceWorkerRegistration>
}

/**
 * Installs the service worker that lets `<img>`, `srcset`, `<picture>` and CSS show .ssplat files. Pictures that failed before the worker was
 * active are loaded again. Resolves to whether the worker serves this page: false if the browser has no service workers, as in pages without
 * HTTPS. Rejects if the script cannot be loaded.
 */
export function registerSsplat(options?: RegisterOptions): Promise<boolean>
