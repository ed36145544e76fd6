import { firstUrls } from "../source/addresses.js";
import { offerEarly } from "../source/early.js";
import { preloadSource } from "./preload.js";

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

/** @typedef {import("./messages.js").FromPlayer} FromPlayer */
/** @typedef {import("./messages.js").ToPlayer} ToPlayer */

/** The two workers of a play: one for network and decoding, and one that takes its frames. */
export class PlayerWorkers {
  /** Aborts early requests. */
  #opening = new AbortController();

  /**
   * @param {import("./messages.js").Source} source @param {import("./messages.js").Start} start
   * @param {Worker} sink takes the frames from the port that it is sent
   * @param {(message: FromPlayer) => void} onMessage called for messages of the decoding worker
   */
  constructor(source, start, sink, onMessage) {
    const { port1, port2 } = new MessageChannel();
    /** @type {Worker} */ this.sink = sink;
    sink.postMessage({ port: port2 }, [port2]);
    /** @type {Worker} */ this.player = startWorker(new URL("./playworker.js", import.meta.url));
    preloadSource(source.base);
    this.player.onmessage = (/** @type {MessageEvent<FromPlayer>} */ { data }) => onMessage(data);
    const fail = (/** @type {string} */ message) => onMessage({ kind: "failed", message });
    for (const worker of [this.player, sink]) {
      worker.onerror = ({ message }) => {
        // The error of a worker that never started has no message.
        const why =
          message ?? "one of its scripts was not loaded; see the errors in the browser's console";
        fail(`The player failed: ${why}`);
      };
    }
    // A stream that is opened again at a frame was played or sought before.
    const isHeld = source.isHeld && start.frame === null;
    const transformRequest = requestPort(source.transformRequest, fail);
    // The page's own requests are sent as they are.
    const isPlain = source.credentials === undefined && transformRequest === undefined;
    const urls = isPlain ? firstUrls(source.base) : [];
    const early = offerEarly(urls, this.#opening.signal);
    const ports = [port1, ...early.map(({ port }) => port)];
    if (transformRequest) ports.push(transformRequest);
    const wish = { ...source, transformRequest, isHeld, start, early };
    this.post({ kind: "open", ...wish, port: port1 }, ports);
  }

  /** @param {ToPlayer} message for the decoding worker @param {Transferable[]} [transfer] */
  post(message, transfer = []) {
    this.player.postMessage(message, transfer);
  }

  terminate() {
    this.#opening.abort();
    this.player.terminate();
    this.sink.terminate();
  }
}

/**
 * A port through which a worker asks the page how to send each of its requests, because a function cannot be posted;
 * undefined if the page changes none.
 * @param {import("../source/transform.js").TransformRequest | undefined} transformRequest
 * @param {(message: string) => void} fail called if the code for it cannot be loaded
 */
export function requestPort(transformRequest, fail) {
  if (!transformRequest) return undefined;
  const { port1, port2 } = new MessageChannel();
  import("../source/transform.js").then(
    (module) => module.answer(port1, transformRequest),
    (/** @type {unknown} */ error) =>
      fail(`The code for transformRequest could not be loaded: ${error}`),
  );
  return port2;
}
