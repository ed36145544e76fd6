/**
 * `fetch` for a worker whose page may have sent the request already; see earlyrequests.js.
 */

/** @typedef {import("./earlyrequests.js").EarlyOffer} EarlyOffer */
/** @typedef {{ status: number, headers: [string, string][], body: ReadableStream | null }} EarlyResponse */

/** @type {Map<string, MessagePort>} by URL */
const ports = new Map();

/** Registers the page's offers. @param {EarlyOffer[]} offers */
export function expectEarly(offers) {
  for (const { url, port } of offers) ports.set(url, port);
}

/**
 * The response to a GET: that of the page if it has requested this URL, otherwise a new one.
 * @param {string} url
 * @param {RequestInit} [init]
 * @returns {Promise<Response>} rejects as `fetch` does
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
