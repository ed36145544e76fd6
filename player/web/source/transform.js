/**
 * A page's function that changes requests. It runs in the page; a worker, to which no function can be posted, asks
 * for each request through a port. This code is loaded only where a page has such a function.
 */

/**
 * What a page changes of a request; what is left out stays.
 * @typedef {object} RequestChange
 * @property {string} [url]
 * @property {HeadersInit} [headers] in addition to those of the player, which cannot be replaced
 * @property {RequestCredentials} [credentials]
 */

/** @typedef {(url: string) => RequestChange | null | undefined | Promise<RequestChange | null | undefined>} TransformRequest */

/** @typedef {{ url: string, headers: [string, string][], credentials?: RequestCredentials }} Change one that can be posted */

const CREDENTIALS = ["omit", "same-origin", "include"];

/**
 * What the page's function makes of a URL. Rejects with one line that says what is wrong with it.
 * @param {TransformRequest} transformRequest @param {string} url @returns {Promise<Change>}
 */
async function changeOf(transformRequest, url) {
  try {
    const change = (await transformRequest(url)) ?? {};
    if (typeof change !== "object") throw new TypeError(`it returned ${change}, not an object`);
    const { credentials } = change;
    if (credentials !== undefined && !CREDENTIALS.includes(credentials))
      throw new TypeError(`credentials may not be ${credentials}`);
    const { href } = new URL(change.url ?? url, url);
    return { url: href, headers: [...new Headers(change.headers)], credentials };
  } catch (error) {
    const why = error instanceof Error ? error.message : error;
    throw new Error(`transformRequest failed for ${url}: ${why}`, { cause: error });
  }
}

/** Answers what a worker asks through `port`. @param {MessagePort} port @param {TransformRequest} transformRequest */
export function answer(port, transformRequest) {
  /** @param {MessageEvent<{ url: string, reply: MessagePort }>} question */
  port.onmessage = async ({ data: { url, reply } }) => {
    try {
      reply.postMessage({ change: await changeOf(transformRequest, url) });
    } catch (error) {
      reply.postMessage({ why: /** @type {Error} */ (error).message });
    }
  };
}

/** @param {MessagePort} port @param {string} url @param {Promise<never>} aborted @returns {Promise<Change>} */
async function ask(port, url, aborted) {
  const { port1, port2 } = new MessageChannel();
  try {
    /** @type {Promise<{ change?: Change, why?: string }>} */
    const answered = new Promise((resolve) => (port1.onmessage = ({ data }) => resolve(data)));
    port.postMessage({ url, reply: port2 }, [port2]);
    const { change, why } = await Promise.race([answered, aborted]);
    if (change === undefined) throw new Error(why);
    return change;
  } finally {
    port1.close();
  }
}

/**
 * The arguments of `fetch` for a request, as the page wants it. Rejects with one line if the page's function fails,
 * and with the signal's reason if that aborts.
 * @param {TransformRequest | MessagePort} transformRequest the page's function, or in a worker the port to it
 * @param {string} url @param {RequestInit} init @returns {Promise<[string, RequestInit]>}
 */
export async function transformed(transformRequest, url, init) {
  const { signal } = init;
  signal?.throwIfAborted();
  /** @type {Promise<never>} */
  const aborted = new Promise((_, reject) =>
    signal?.addEventListener("abort", () => reject(signal.reason), { once: true }),
  );
  aborted.catch(() => {}); // it may abort later
  const change =
    typeof transformRequest === "function"
      ? await Promise.race([changeOf(transformRequest, url), aborted])
      : await ask(transformRequest, url, aborted);
  const { headers, credentials, url: to } = change;
  const all = new Headers(headers);
  for (const [name, value] of new Headers(init.headers)) all.set(name, value);
  return [to, { ...init, headers: all, ...(credentials && { credentials }) }];
}
