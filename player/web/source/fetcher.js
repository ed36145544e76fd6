import { fetchOnce } from "./early/earlyresponses.js";

/** A stream cannot be fetched; the message gives the remedy. */
export class SourceError extends Error {
  /** @param {string} message */
  constructor(message) {
    super(message);
    this.name = "SourceError";
  }
}

/** A failure that may be over at the next try. */
class PassingTrouble extends TypeError {}

const FIRST_DELAY_S = 0.25;
/** Well below the buffered time, so that a returning network is noticed before playback stalls. */
const LONGEST_DELAY_S = 1;

/** Number of failures of a host before checking whether it only refuses this page (CORS). */
export const TRIES_BEFORE_DOUBT = 3;

/** Seconds to wait after try number `tries`. @param {number} tries from 1 on */
export function delayS(tries) {
  const mostS = Math.min(LONGEST_DELAY_S, FIRST_DELAY_S * 2 ** (tries - 1));
  // Random, so that clients that lost a server together do not return all at once.
  return mostS * (0.5 + 0.5 * Math.random());
}

/** Ends a response that is not read, so that its host stops sending. @param {Response} response */
export function discard({ body }) {
  body?.cancel().catch(() => {}); // it may have broken off itself
}

/** The error for a host that works, but refuses this page (CORS). @param {string} url */
export function refusal(url) {
  return new SourceError(
    `${new URL(url).origin} answers, but does not let pages of other hosts read ${url}; ` +
      "configure that host to send the header Access-Control-Allow-Origin (docs/EMBED.md)",
  );
}

/**
 * Fetches files, with retries while the network or the server is unreachable.
 */
export class Fetcher {
  /**
   * @param {object} [options]
   * @param {number} [options.giveUpS] seconds without new bytes after which it gives up
   * @param {(message: string | null) => void} [options.onTrouble] called with a description of the
   *   problem, and with null when it is over
   * @param {RequestCredentials} [options.credentials] whether requests carry cookies, see `fetch`
   */
  constructor({ giveUpS = 60, onTrouble = () => {}, credentials } = {}) {
    this.giveUpS = giveUpS;
    this.credentials = credentials;
    this.onTrouble = onTrouble;
    this.receivedBytes = 0;
  }

  /**
   * Sends a request without retries; rejects as `fetch` does.
   * @param {string} url
   * @param {RequestInit} [init]
   */
  fetch(url, init) {
    return fetchOnce(url, { credentials: this.credentials, ...init });
  }

  /**
   * The bytes at a URL, at most `limitBytes`. Rejects with a SourceError, or if the signal of `init` aborts.
   * @param {string} url
   * @param {number} limitBytes
   * @param {(numBytes: number) => void} [onBytes] called with the size of each piece; after a failed try,
   *   its bytes are subtracted by a call with a negative number
   * @param {RequestInit} [init]
   * @param {(response: Response) => void} [check] throws if the response does not match the request
   * @returns {Promise<Uint8Array>}
   */
  async get(url, limitBytes, onBytes = () => {}, init = {}, check = () => {}) {
    if (url.startsWith("file:")) {
      throw new SourceError(
        `A page may not read ${url}; play it from a web server (docs/EMBED.md)`,
      );
    }
    let goodMs = performance.now();
    let most = 0;
    let answers = false;
    for (let tries = 1; ; tries++) {
      let came = 0;
      const count = (/** @type {number} */ numBytes) => {
        came += numBytes;
        this.receivedBytes += numBytes;
        if (came > most) {
          most = came;
          goodMs = performance.now();
        }
        onBytes(numBytes);
      };
      try {
        const bytes = await this.#once(url, limitBytes, count, init, check);
        if (tries > 1) this.onTrouble(null);
        return bytes;
      } catch (error) {
        onBytes(-came);
        init.signal?.throwIfAborted();
        // Without a network, fetch throws a TypeError.
        if (!(error instanceof TypeError)) throw error;
        if (tries >= TRIES_BEFORE_DOUBT && !(error instanceof PassingTrouble)) {
          if (answers) throw refusal(url);
          answers = await this.isRefused(url);
          if (answers) continue; // once more, since the network may be back
        }
        if (performance.now() - goodMs > 1000 * this.giveUpS) {
          throw new SourceError(`${url} cannot be reached; check the network and try again`);
        }
        this.onTrouble("The network is gone; trying again");
      }
      await new Promise((resolve) => setTimeout(resolve, 1000 * delayS(tries)));
    }
  }

  /**
   * A byte range of the file at a URL, shorter only at the file's end, and the size of the file, which is
   * null if the host hides it. Rejects like `get`, and if the host does not support ranges.
   * @param {string} url
   * @param {import("../format/packedlayout.js").Place} place
   * @param {(numBytes: number) => void} [onBytes] see `get`
   * @param {RequestInit} [init]
   */
  async range(url, { first, size }, onBytes, init = {}) {
    /** @type {number | null} */
    let fileBytes = null;
    const check = (/** @type {Response} */ response) => {
      if (response.status !== 206) {
        throw new SourceError(
          `${url}: this host does not send parts of a file, as a .swings file needs; use another host, ` +
            "or swings-stream unpack",
        );
      }
      // From another origin, the header is visible only if the host exposes it.
      const found = /^bytes (\d+)-\d+\/(\d+)$/.exec(response.headers.get("Content-Range") ?? "");
      if (found === null) return;
      fileBytes = Number(found[2]);
      if (Number(found[1]) !== first)
        throw new SourceError(`${url}: the host sent another part than requested`);
    };
    const headers = { Range: `bytes=${first}-${first + size - 1}` };
    // The browser's cache would serialise the requests for parts of the same file.
    const request = /** @type {RequestInit} */ ({ ...init, headers, cache: "no-store" });
    const bytes = await this.get(url, size, onBytes, request, check);
    return { bytes, fileBytes: /** @type {number | null} */ (fileBytes) };
  }

  /**
   * Whether a host of another origin is reachable, but does not let this page read its responses. To a
   * page, this looks like a missing network.
   * @param {string} url
   */
  async isRefused(url) {
    if (this.receivedBytes > 0 || new URL(url).origin === globalThis.origin) return false;
    try {
      await fetch(url, { method: "HEAD", mode: "no-cors" });
      return true;
    } catch {
      return false;
    }
  }

  /**
   * @param {string} url
   * @param {number} limitBytes
   * @param {(numBytes: number) => void} onBytes
   * @param {RequestInit} init
   * @param {(response: Response) => void} check
   */
  async #once(url, limitBytes, onBytes, init, check) {
    const response = await this.fetch(url, init);
    try {
      if (response.status >= 500) throw new PassingTrouble(`HTTP ${response.status}`);
      if (!response.ok) throw new SourceError(`${url}: HTTP ${response.status}`);
      check(response);
    } catch (error) {
      discard(response);
      throw error;
    }
    /** @type {Uint8Array[]} */
    const pieces = [];
    let size = 0;
    const reader = /** @type {ReadableStream<Uint8Array>} */ (response.body).getReader();
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      size += value.length;
      if (size > limitBytes) {
        await reader.cancel();
        throw new SourceError(`${url} has more than ${limitBytes} bytes; this is not a stream`);
      }
      pieces.push(value);
      onBytes(value.length);
    }
    const bytes = new Uint8Array(size);
    let at = 0;
    for (const piece of pieces) {
      bytes.set(piece, at);
      at += piece.length;
    }
    return bytes;
  }
}
