/** Names of the player's workers; a bundler may add a hash. */
const WORKERS = /\/(play|sort|feed)worker[^/]*\.js$/;
/** Where this code is from. */
const HOME = new URL(import.meta.url).origin;
/** Key of the policy in the page: a second copy of this code must not create one with the same name. */
const POLICY = Symbol.for(`swings-worker ${HOME}`);

/**
 * @typedef {{ createScriptURL: (module: string) => string }} Policy
 * @typedef {Record<typeof POLICY, Policy | undefined>
 *   & { trustedTypes?: { createPolicy: (name: string, rules: Policy) => Policy } }} Page
 */

/**
 * Starts one of the player's workers. It works from any origin, although a page may not directly start
 * a worker of another origin, and also on pages whose content security policy requires Trusted Types and
 * lists the allowed policies.
 * @param {URL} module
 */
export function startWorker(module) {
  const page = /** @type {Page} */ (/** @type {unknown} */ (globalThis));
  page[POLICY] ??= page.trustedTypes?.createPolicy("swings-worker", { createScriptURL: startable });
  const script = page[POLICY]?.createScriptURL(module.href) ?? startable(module.href);
  const worker = new Worker(script, { type: "module" });
  if (String(script).startsWith("blob:")) URL.revokeObjectURL(String(script));
  return worker;
}

/**
 * The URL at which this page may start a worker's module. Any script of the page can reach the policy, so it
 * serves the player's workers only, from this page's origin and from that of this code.
 * @param {string} module
 */
function startable(module) {
  const { origin, pathname } = new URL(module);
  const isOurs = WORKERS.test(pathname) && [globalThis.origin, HOME].includes(origin);
  if (!isOurs) throw new TypeError(`${module} is no worker of swings-player`);
  if (origin === globalThis.origin) return module;
  const script = `import ${JSON.stringify(module)};`;
  // For a page from a file or in a sandbox, Chromium does not run modules from blobs.
  if (globalThis.origin === "null") return `data:text/javascript,${encodeURIComponent(script)}`;
  return URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
}
