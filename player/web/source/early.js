/**
 * Requests that the page sends while the player, or its worker, is still being loaded, and the worker's use
 * of their responses.
 */

/**
 * A request whose response was not used yet.
 * @typedef {object} EarlyRequest
 * @property {Promise<Response>} response @property {AbortController} abort
 */

/** @typedef {{ url: string, port: MessagePort }} EarlyOffer a response to be passed to a worker */

/** Global, because the page's own script and the player are in separate bundles. */
const shared = /** @type {{ swingsEarly?: Map<string, EarlyRequest> }} */ (globalThis);
/** @returns {Map<string, EarlyRequest>} */
const requests = () => (shared.swingsEarly ??= new Map());

/** @param {string} url */
export function requestEarly(url) {
  const abort = new AbortController();
  const response = fetch(url, { cache: "no-store", signal: abort.signal });
  response.catch(() => {}); // the worker tries again, and reports errors
  const request = { response, abort };
  requests().set(url, request);
  return request;
}

/**
 * Offers early responses for `urls` to a worker; each one can be used once. What the page has not requested
 * yet is requested now.
 * @param {string[]} urls @param {AbortSignal} signal aborts them
 * @returns {EarlyOffer[]} to be posted, with their ports transferred
 */
export function offerEarly(urls, signal) {
  /** @type {EarlyOffer[]} */
  const offers = [];
  for (const url of urls) {
    const request = requests().get(url) ?? requestEarly(url);
    requests().delete(url);
    const { port1, port2 } = new MessageChannel();
    signal.addEventListener("abort", () => request.abort.abort());
    port2.onmessage = () => request.abort.abort();
    send(request, port2);
    offers.push({ url, port: port1 });
  }
  return offers;
}

/** @param {EarlyRequest} request @param {MessagePort} port */
async function send({ response, abort }, port) {
  try {
    const { status, headers, body } = await response;
    const head = { status, headers: [...headers] };
    port.postMessage({ ...head, body }, body === null ? [] : [body]);
  } catch (error) {
    console.debug(`An early request is of no use: ${error}`);
    // Without a network, or in a browser that cannot transfer streams, the worker sends its own request.
    abort.abort();
    port.postMessage(null);
  }
}

/** @typedef {{ status: number, headers: [string, string][], body: ReadableStream | null }} EarlyResponse */

/** @type {Map<string, MessagePort>} by URL */
const ports = new Map();

/** Registers the page's offers. @param {EarlyOffer[]} offers */
export function expectEarly(offers) {
  for (const { url, port } of offers) ports.set(url, port);
}

/**
 * The response to a GET: that of the page if it has requested this URL, otherwise a new one.
 * @param {string} url @param {RequestInit} [init] @returns {Promise<Response>} rejects as `fetch` does
 */
export async function fetchOnce(url, init = {}) {
  const port = ports.get(url);
  if (port === undefined) return fetch(url, init);
  ports.delete(url);
  const { signal } = init;
  signal?.addEventListener("abort", () => port.postMessage("abort"));
  const early = await new Promise(
    (/** @type {(response: EarlyResponse | null) => void} */ resolve) =>
      (port.onmessage = ({ data }) => resolve(data)),
  );
  signal?.throwIfAborted();
  if (early === null) return fetch(url, init);
  const { status, headers, body } = early;
  return new Response(body, { status, headers });
}
