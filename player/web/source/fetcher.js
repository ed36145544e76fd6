/** Fetches files, with retries while the network or the server is unreachable; and the errors of fetching. */

import { fileUrl } from "./addresses.js";
import { fetchOnce } from "./early.js";

const FIRST_DELAY_S = 0.25;
/** Well below the buffered time, so that a returning network is noticed before playback stalls. */
const LONGEST_DELAY_S = 1;

/** Seconds to wait after try number `tries`. @param {number} tries from 1 on */
export function delayS(tries) {
  const mostS = Math.min(LONGEST_DELAY_S, FIRST_DELAY_S * 2 ** (tries - 1));
  // Random, so that clients that lost a server together do not return all at once.
  return mostS * (0.5 + 0.5 * Math.random());
}

/** @param {number} seconds */
export const rest = (seconds) => new Promise((resolve) => setTimeout(resolve, 1000 * seconds));

/**
 * What all requests to a host pass: freely while they are answered, and one at a time, with growing delays,
 * while the network is gone.
 */
class Gate {
  /** Number of tries in a row that were not answered. */
  #tries = 0;
  /** The earliest time of the next try. */
  #openMs = 0;
  /** @type {Promise<void> | null} resolves when the trial that is under way has ended */
  #trial = null;
  #endTrial = () => {};

  /**
   * Resolves when the caller may send a request; `leave` must follow.
   * @returns {Promise<boolean>} whether it is a trial: the only request until it is answered
   */
  async enter() {
    while (this.#trial !== null) await this.#trial;
    if (this.#tries === 0) return false;
    this.#trial = new Promise((resolve) => (this.#endTrial = resolve));
    await rest(Math.max(0, this.#openMs - performance.now()) / 1000);
    return true;
  }

  /**
   * To be called when a request that has entered is answered or has failed.
   * @param {boolean} isTrial what `enter` gave
   * @param {boolean | null} isAnswered null: the caller has given it up
   */
  leave(isTrial, isAnswered) {
    if (isAnswered) this.#tries = 0;
    // The first of the requests that were under way when the network went closes the gate.
    else if (isAnswered === false && (isTrial || this.#tries === 0)) {
      this.#tries += 1;
      this.#openMs = performance.now() + 1000 * delayS(this.#tries);
    }
    if (!isTrial) return;
    this.#trial = null;
    this.#endTrial();
  }
}

/** Another stream is at the URL of the one that plays. */
export const REPLACED = "This video was replaced";

/** A stream cannot be fetched; the message gives the remedy. */
export class SourceError extends Error {
  name = "SourceError";
}

/** A failure that may be over at the next try. */
class PassingTrouble extends TypeError {}

export const GONE = "The network is gone";
export const SILENT = "The host does not answer";

/** The host is connected, but sends nothing. */
export class SilentError extends PassingTrouble {
  constructor() {
    super(SILENT);
  }
}

/** Seconds without a byte from the host after which a request is sent again. */
const SILENT_S = 15;

/** Number of failures of a host before checking whether it only refuses this page (CORS). */
export const TRIES_BEFORE_DOUBT = 3;

/** Ends a response that is not read, so that its host stops sending. @param {Response} response */
export function discard({ body }) {
  body?.cancel().catch(() => {}); // it may have broken off itself
}

/** Fetches files, with retries while the network or the server is unreachable. */
export class Fetcher {
  receivedBytes = 0;
  /** Whether the last thing that `get` has said is a problem. */
  hasTrouble = false;
  gate = new Gate();
  heardMs = -Infinity;

  /**
   * @param {object} [options] @param {number} [options.giveUpS] seconds without new bytes after which it gives up
   * @param {(message: string | null) => void} [options.onTrouble] called with a description of the
   *   problem, and with null when it is over
   * @param {(picture: string | null) => void} [options.onAwaited] called again and again while a stream
   *   has no frames, with the URL of its poster
   * @param {RequestCredentials} [options.credentials] whether requests carry cookies, see `fetch`
   * @param {import("./transform.js").TransformRequest | MessagePort} [options.transformRequest] changes each
   *   request; in a worker, the port to the page's function
   */
  constructor({ giveUpS = 60, onTrouble = () => {}, onAwaited = () => {}, ...access } = {}) {
    /** @type {number} */ this.giveUpS = giveUpS;
    /** How the page wants requests to be sent. */
    this.access = access;
    this.onTrouble = onTrouble;
    this.onAwaited = onAwaited;
  }

  /**
   * To be called while a stream has no frames.
   * @param {string} base @param {import("../format/manifest.js").Manifest} manifest
   */
  awaitFrames(base, { poster }) {
    this.onTrouble("This stream has no frames yet; it starts when the first frames arrive");
    this.onAwaited(poster ? fileUrl(poster, base) : null);
  }

  /** To be called when something has come from the host. */
  heard() {
    this.heardMs = performance.now();
  }

  /**
   * Calls `onSilence` once nothing has come from the host for SILENT_S, although it was asked.
   * @param {() => void} onSilence @returns {() => void} ends the watch
   */
  watch(onSilence) {
    const beganMs = performance.now();
    /** @type {number | undefined} */
    let timer;
    const look = () => {
      const endMs = Math.max(beganMs, this.heardMs) + 1000 * SILENT_S;
      const restMs = endMs - performance.now();
      if (restMs > 0) timer = setTimeout(look, restMs);
      else onSilence();
    };
    look();
    return () => clearTimeout(timer);
  }

  /** Sends a request at once; rejects as `fetch` does. @param {string} url @param {RequestInit} [init] */
  async send(url, init) {
    return fetchOnce(...(await this.#request(url, init)));
  }

  /**
   * A request as the page wants it.
   * @param {string} url @param {RequestInit} [init] @returns {Promise<[string, RequestInit]>}
   */
  async #request(url, init) {
    const { credentials, transformRequest } = this.access;
    const request = { credentials, ...init };
    if (!transformRequest) return [url, request];
    const code = await import("./transform.js"); // whole, as the page has it
    return code.transformed(transformRequest, url, request).catch((/** @type {Error} */ error) => {
      request.signal?.throwIfAborted();
      throw new SourceError(error.message);
    });
  }

  /**
   * Sends a request without retries, in its turn if the network is gone; rejects as `fetch` does, and with a
   * SilentError.
   * @param {string} url @param {RequestInit} [init]
   */
  async fetch(url, init = {}) {
    const { gate } = this;
    const isTrial = await gate.enter();
    const silence = new AbortController();
    const stop = this.watch(() => silence.abort(new SilentError()));
    const signals = init.signal ? [init.signal, silence.signal] : [silence.signal];
    try {
      const signal = AbortSignal.any(signals);
      const response = await this.send(url, { ...init, signal });
      this.heard();
      gate.leave(isTrial, true);
      return response;
    } catch (error) {
      gate.leave(isTrial, init.signal?.aborted ? null : false);
      throw silence.signal.aborted ? silence.signal.reason : error;
    } finally {
      stop();
    }
  }

  /**
   * The bytes at a URL, at most `limitBytes`. Rejects with a SourceError, or if the signal of `init` aborts.
   * @param {string} url @param {number} limitBytes
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
    /** @type {SourceError | null} */
    let refused = null;
    for (let tries = 1; ; tries++) {
      let came = 0;
      const count = (/** @type {number} */ numBytes) => {
        came += numBytes;
        this.receivedBytes += numBytes;
        this.heard();
        if (came > most) {
          most = came;
          goodMs = performance.now();
        }
        onBytes(numBytes);
      };
      try {
        const bytes = await this.#once(url, limitBytes, count, init, check);
        if (this.hasTrouble) this.onTrouble(null);
        this.hasTrouble = false;
        return bytes;
      } catch (error) {
        onBytes(-came);
        init.signal?.throwIfAborted();
        // Without a network, fetch throws a TypeError.
        if (!(error instanceof TypeError)) throw error;
        if (tries >= TRIES_BEFORE_DOUBT && !(error instanceof PassingTrouble)) {
          if (refused) throw refused;
          refused = await this.findRefusal(url);
          if (refused) continue; // once more, since the network may be back
        }
        if (performance.now() - goodMs > 1000 * this.giveUpS)
          throw new SourceError(`${url} cannot be reached; check the network and try again`);
        const why = error instanceof SilentError ? SILENT : GONE;
        this.hasTrouble = true;
        this.onTrouble(`${why}; trying again`);
      }
      await rest(delayS(tries));
    }
  }

  /**
   * The reason why a host that is reachable cannot be read; null if there is none. To a page, such a host
   * looks like a missing network.
   * @param {string} url
   */
  async findRefusal(url) {
    if (this.receivedBytes > 0) return null;
    try {
      const { refusalOf } = await import("./refusal.js");
      const [asked] = await this.#request(url);
      const message = await refusalOf(asked);
      return message === null ? null : new SourceError(message);
    } catch (error) {
      console.warn("swings: no reason found:", error);
      return null;
    }
  }

  /**
   * @param {string} url @param {number} limitBytes @param {(numBytes: number) => void} onBytes
   * @param {RequestInit} init @param {(response: Response) => void} check
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
    let isSilent = false;
    const stop = this.watch(() => {
      isSilent = true;
      reader.cancel().catch(() => {}); // ends the read that waits; it may have broken off itself
    });
    try {
      for (;;) {
        const { done, value } = await reader.read();
        if (isSilent) throw new SilentError();
        if (done) break;
        size += value.length;
        if (size > limitBytes) {
          await reader.cancel();
          throw new SourceError(`${url} has more than ${limitBytes} bytes; this is not a stream`);
        }
        pieces.push(value);
        onBytes(value.length);
      }
    } finally {
      stop();
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
