/**
 * Starts one of the player's workers. It works from any origin, although a page may not directly start
 * a worker of another origin.
 * @param {URL} url of the module in the sources; in a bundle, the workers are in the same folder
 */
export function startWorker(url) {
  const name = /** @type {string} */ (url.pathname.split("/").pop());
  // @ts-ignore scripts/webbundle defines it
  const module = typeof SWINGS_BUNDLE === "undefined" ? url : new URL(name, import.meta.url);
  if (module.origin === globalThis.origin) return moduleWorker(module.href);
  const script = `import ${JSON.stringify(module.href)};`;
  if (globalThis.origin === "null") {
    // For a page from a file or in a sandbox, Chromium does not run modules from blobs.
    return moduleWorker(`data:text/javascript,${encodeURIComponent(script)}`);
  }
  const blobUrl = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
  const worker = moduleWorker(blobUrl);
  URL.revokeObjectURL(blobUrl);
  return worker;
}

/** Key of the policy in the page: a second copy of this code must not create one with the same name. */
const POLICY = Symbol.for("swings-worker");

/**
 * Starts a module worker, also on pages whose content security policy requires Trusted Types and lists
 * the allowed policies.
 * @param {string} url
 */
function moduleWorker(url) {
  const page = /** @type {any} */ (globalThis);
  page[POLICY] ??= page.trustedTypes?.createPolicy("swings-worker", {
    createScriptURL: (/** @type {string} */ own) => own,
  });
  return new Worker(page[POLICY]?.createScriptURL(url) ?? url, { type: "module" });
}
