import { corrupt } from "../format/bytes/errors.js";
import { RecordParser } from "../format/playrecord.js";
import { playUrl } from "./addresses.js";
import { fetchOnce } from "./early/earlyresponses.js";
import { delayS, refusal, SourceError, TRIES_BEFORE_DOUBT } from "./fetcher.js";

/** The server is gone, or has no time; it may be back soon. */
export class GoneError extends Error {
  /**
   * @param {string} message
   * @param {number} afterS not to be tried again before so many seconds
   */
  constructor(message, afterS = 0) {
    super(message);
    this.name = "GoneError";
    this.afterS = afterS;
  }
}

const GONE = "The network is gone";
const BUSY = "The server is busy";

/**
 * Parameters of a /play request.
 * @typedef {object} PlayQuery
 * @property {number} fromFrame
 * @property {number} [untilFrame] the first frame that is not sent
 * @property {number | null} [layers] null for the server's choice
 * @property {string | null} [lastToken] of the play before this one
 * @property {number | null} [rateBps] the last estimate of the link that a server sent
 * @property {boolean} [paused] whether it begins with a still picture
 * @property {number | null} [nextFrame] the frame that shows next, if the frames up to fromFrame are here
 */

/** One response of a swings server to `play?plain=1`, record by record (FORMAT.md, section 12). */
export class PlayResponse {
  /**
   * @param {Response} response
   * @param {AbortController} abort
   */
  constructor(response, abort) {
    const { body } = response;
    if (body === null) throw new GoneError(GONE);
    this.token = response.headers.get("Swings-Play");
    this.abort = abort;
    this.reader = body.getReader();
    this.parser = new RecordParser();
    /** @type {import("../constants.js").PlayRecord[]} parsed, but not handed out */
    this.records = [];
    this.uncountedBytes = 0;
  }

  /**
   * Rejects with a GoneError, or with a SourceError if trying again would not help.
   * @param {string} base URL of the stream, with a slash at its end
   * @param {PlayQuery} query
   * @param {AbortSignal} [signal] ends it
   */
  static async open(base, query, signal) {
    const { lastToken, rateBps, nextFrame } = query;
    const url = playUrl(base, query);
    const abort = new AbortController();
    signal?.addEventListener("abort", () => abort.abort(), { once: true });
    if (signal?.aborted) abort.abort();
    const headers = new Headers(lastToken ? { "Swings-Play": lastToken } : {});
    if (rateBps) headers.set("Swings-Rate", String(rateBps));
    if (typeof nextFrame === "number") headers.set("Swings-Frame", String(nextFrame));
    let response;
    try {
      response = await fetchOnce(url, { headers, signal: abort.signal, cache: "no-store" });
    } catch {
      throw new GoneError(GONE);
    }
    if (response.status >= 500) {
      throw new GoneError(BUSY, Number(response.headers.get("Retry-After")) || 0);
    }
    if (!response.ok) throw new SourceError(`${base}: HTTP ${response.status}`);
    return new PlayResponse(response, abort);
  }

  /**
   * The next record; null at the end of the body. Rejects with a GoneError, or with a FormatError.
   * @param {(numBytes: number) => void} [onBytes] called with the decoded bytes that no call has had yet
   * @returns {Promise<import("../constants.js").PlayRecord | null>}
   */
  async next(onBytes) {
    while (this.records.length === 0) {
      let piece;
      try {
        piece = await this.reader.read();
      } catch {
        throw new GoneError(GONE);
      }
      if (piece.done) return null;
      this.uncountedBytes += piece.value.length;
      this.records = this.parser.feed(piece.value);
    }
    if (onBytes) {
      onBytes(this.uncountedBytes);
      this.uncountedBytes = 0;
    }
    return this.records.shift() ?? null;
  }

  close() {
    this.abort.abort();
  }
}

/** @typedef {{ response: PlayResponse, start: import("../constants.js").StartRecord }} OpenedPlay */

/**
 * A response, and how it starts. Rejects as PlayResponse.open does.
 * @param {string} base
 * @param {PlayQuery} query
 * @param {AbortSignal} [signal] ends it
 * @returns {Promise<OpenedPlay>}
 */
export async function openPlay(base, query, signal) {
  const response = await PlayResponse.open(base, query, signal);
  const start = await response.next();
  if (start === null) throw new GoneError(GONE);
  if (start.kind !== "start") throw corrupt("play: the first record is not a start record");
  return { response, start };
}

/** How often and how long a server that is gone is tried again. */
export class ServerRetry {
  /**
   * @param {import("./fetcher.js").Fetcher} fetcher whose `giveUpS` and `onTrouble` hold
   * @param {string} base URL of the stream
   */
  constructor(fetcher, base) {
    this.fetcher = fetcher;
    this.base = base;
    /** What was wrong last. */
    this.why = GONE;
    this.tries = 0;
    this.sinceMs = 0;
    /** Whether nothing waits for it any more. */
    this.isOver = false;
  }

  /** All is well. */
  reset() {
    if (this.tries > 0) this.fetcher.onTrouble(null);
    this.tries = 0;
  }

  /**
   * Tries until it works. Rejects with a SourceError after a while, and with what else goes wrong.
   * @param {() => Promise<OpenedPlay>} action
   */
  async begin(action) {
    for (;;) {
      try {
        const begun = await action();
        this.fetcher.onTrouble(null);
        return begun;
      } catch (error) {
        if (!(error instanceof GoneError) || this.isOver) throw error;
        this.why = error.message;
        await this.wait(error.afterS);
      }
    }
  }

  /**
   * Reports what is wrong, and waits until the next try. Rejects with a SourceError after a while.
   * @param {number} leastS
   */
  async wait(leastS = 0) {
    const { fetcher, base, why } = this;
    if (this.tries === 0) this.sinceMs = performance.now();
    this.tries += 1;
    const isDoubtful = why === GONE && this.tries >= TRIES_BEFORE_DOUBT;
    if (isDoubtful && (await fetcher.isRefused(base))) throw refusal(base);
    if (performance.now() - this.sinceMs > 1000 * fetcher.giveUpS) {
      throw new SourceError(
        why === GONE
          ? `${base} cannot be reached; check the network and try again`
          : `${base}: ${why}`,
      );
    }
    fetcher.onTrouble(`${why}; trying again`);
    const restS = Math.max(delayS(this.tries), Math.min(leastS, fetcher.giveUpS));
    await new Promise((resolve) => setTimeout(resolve, 1000 * restS));
  }
}
