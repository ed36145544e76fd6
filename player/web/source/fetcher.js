import { fetchOnce } from "./early/earlyresponses.js";

/** A stream that cannot be fetched; the message gives the remedy. */
export class SourceError extends Error {
  /** @param {string} message */
  constructor(message) {
    super(message);
    this.name = "SourceError";
  }
}

/** What may have gone when it is asked again. */
class PassingTrouble extends TypeError {}

const FIRST_DELAY_S = 0.25;
/** Well below what is buffered: a network that comes back is noticed before the picture stalls. */
const LONGEST_DELAY_S = 1;

/** So often a host must have failed before it is asked whether it only refuses this page. */
export const TRIES_BEFORE_DOUBT = 3;

/** How long to wait before try number `tries`, seconds. @param {number} tries from 1 on */
export function delayS(tries) {
  const mostS = Math.min(LONGEST_DELAY_S, FIRST_DELAY_S * 2 ** (tries - 1));
  // Clients that lost a server together do not come back together.
  return mostS * (0.5 + 0.5 * Math.random());
}

/** The error for a host that only refuses this page. @param {string} url */
export function refusal(url) {
  return new SourceError(
    `${new URL(url).origin} answers, but does not let pages of other hosts read ${url}; ` +
      "configure that host to send the header Access-Control-Allow-Origin (docs/EMBED.md)",
  );
}

/**
 * Fetches files, again and again while the network or the server is gone.
 */
export class Fetcher {
  /**
   * @param {object} [options]
   * @param {number} [options.giveUpS] seconds without a byte after which it gives up
   * @param {(message: string | null) => void} [options.onTrouble] called with what is wrong, and
   *   with null when it is over
   */
  constructor({ giveUpS = 60, onTrouble = () => {} } = {}) {
    this.giveUpS = giveUpS;
    this.onTrouble = onTrouble;
    this.receivedBytes = 0;
  }

  /**
   * The bytes at a URL, at most `limitBytes`. Rejects with a SourceError, or as the signal of `init` is aborted.
   * @param {string} url
   * @param {number} limitBytes
   * @param {(numBytes: number) => void} [onBytes] called with the size of each piece; a try that
   *   broke off takes its bytes back as a negative number
   * @param {RequestInit} [init]
   * @param {(response: Response) => void} [check] throws if the response is not what was asked for
   * @returns {Promise<Uint8Array>}
   */
  async get(url, limitBytes, onBytes = () => {}, init = {}, check = () => {}) {
    if (url.startsWith("file:")) {
      throw new SourceError(
        `A page may not read ${url}; play it from a web server (docs/EMBED.md)`,
      );
    }
    const beganS = performance.now() / 1000;
    for (let tries = 1; ; tries++) {
      let came = 0;
      const count = (/** @type {number} */ numBytes) => {
        came += numBytes;
        this.receivedBytes += numBytes;
        onBytes(numBytes);
      };
      try {
        const bytes = await this.#once(url, limitBytes, count, init, check);
        if (tries > 1) this.onTrouble(null);
        return bytes;
      } catch (error) {
        onBytes(-came);
        init.signal?.throwIfAborted();
        // What fetch throws when there is no network is a TypeError.
        if (!(error instanceof TypeError)) throw error;
        const isPassing = error instanceof PassingTrouble;
        if (!isPassing && tries >= TRIES_BEFORE_DOUBT && (await this.isRefused(url))) {
          throw refusal(url);
        }
        if (performance.now() / 1000 - beganS > this.giveUpS) {
          throw new SourceError(`${url} cannot be reached; check the network and try again`);
        }
        this.onTrouble("The network is gone; trying again");
      }
      await new Promise((resolve) => setTimeout(resolve, 1000 * delayS(tries)));
    }
  }

  /**
   * A run of bytes of the file at a URL, shorter only where the file ends, and the size of that file:
   * null if the host hides it. Rejects as `get` does, and if the host does not send ranges.
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
      // Of another origin the header shows only if the host exposes it.
      const found = /^bytes (\d+)-\d+\/(\d+)$/.exec(response.headers.get("Content-Range") ?? "");
      if (found === null) return;
      fileBytes = Number(found[2]);
      if (Number(found[1]) !== first)
        throw new SourceError(`${url}: the host sent another part than requested`);
    };
    const headers = { Range: `bytes=${first}-${first + size - 1}` };
    // In its cache a browser would make all parts of one file wait for each other.
    const request = /** @type {RequestInit} */ ({ ...init, headers, cache: "no-store" });
    const bytes = await this.get(url, size, onBytes, request, check);
    return { bytes, fileBytes: /** @type {number | null} */ (fileBytes) };
  }

  /**
   * Whether a host of another origin is there, but never lets this page read what it sends: to a page
   * that looks like a network that is gone.
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
    const response = await fetchOnce(url, init);
    if (response.status >= 500) throw new PassingTrouble(`HTTP ${response.status}`);
    if (!response.ok) throw new SourceError(`${url}: HTTP ${response.status}`);
    check(response);
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
