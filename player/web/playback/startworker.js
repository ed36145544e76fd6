/**
 * Starts a worker of ours, wherever this page comes from: a page may not start one of another origin
 * itself.
 * @param {URL} url of the module among the sources; in a bundle the workers lie beside it
 */
export function startWorker(url) {
  const name = /** @type {string} */ (url.pathname.split("/").pop());
  // @ts-ignore scripts/webbundle defines it
  const module = typeof SWINGS_BUNDLE === "undefined" ? url : new URL(name, import.meta.url);
  if (module.origin === globalThis.origin) return moduleWorker(module.href);
  const script = `import ${JSON.stringify(module.href)};`;
  if (globalThis.origin === "null") {
    // A page from a file, or in a sandbox: Chromium runs no module of its blobs.
    return moduleWorker(`data:text/javascript,${encodeURIComponent(script)}`);
  }
  const blobUrl = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
  const worker = moduleWorker(blobUrl);
  URL.revokeObjectURL(blobUrl);
  return worker;
}

/** Where the page keeps the policy: a second copy of this code may not make another of its name. */
const POLICY = Symbol.for("swings-worker");

/**
 * A page's content security policy may require Trusted Types, and names the policies it allows.
 * @param {string} url
 */
function moduleWorker(url) {
  const page = /** @type {any} */ (globalThis);
  page[POLICY] ??= page.trustedTypes?.createPolicy("swings-worker", {
    createScriptURL: (/** @type {string} */ own) => own,
  });
  return new Worker(page[POLICY]?.createScriptURL(url) ?? url, { type: "module" });
}
