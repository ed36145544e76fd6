/** The response of a swings server to `play`, and when to ask again after it broke or was refused. */

import { corrupt } from "../format/bytes.js";
import { RecordParser } from "../format/playrecord.js";
import { playUrl } from "./addresses.js";
import {
  delayS,
  discard,
  GONE,
  rest,
  SILENT,
  SilentError,
  SourceError,
  TRIES_BEFORE_DOUBT,
} from "./fetcher.js";

/** The server is unreachable or overloaded; it may be back soon. */
export class GoneError extends Error {
  /** @param {string} message @param {number} afterS minimum seconds before the next try @param {unknown} [cause] */
  constructor(message, afterS = 0, cause) {
    super(message, { cause });
    /** @type {string} */ this.name = "GoneError";
    /** @type {number} */ this.afterS = afterS;
  }
}

export const BUSY = "The server is busy";

/** A server that reports the same error in so many answers in a row is believed. */
const MOST_REPORTS = 3;

/** Most points of a report: when how much had come. */
const MOST_POINTS = 24;

/**
 * Parameters of a /play request.
 * @typedef {object} PlayQuery
 * @property {number} fromFrame
 * @property {number} [untilFrame] the first frame that is not sent
 * @property {number | null} [layers] null for the server's choice
 * @property {string | null} [lastToken] token of the previous play
 * @property {number | null} [rateBps] the last estimate of the link's throughput that a server sent
 * @property {boolean} [paused] whether the play begins paused
 * @property {number | null} [nextFrame] the frame that shows next, if the frames up to fromFrame are cached
 */

/** One response of a swings server to `play`, record by record (FORMAT.md, section 12). */
export class PlayResponse {
  bodyBytes = 0;
  /** The bytes of it that are a part of the fetcher's `receivedBytes`. */
  countedBytes = 0;
  /** @type {[number, number][]} [ms, bytes of the body] since the last report */
  points = [];
  parser = new RecordParser();
  /** @type {import("../constants.js").PlayRecord[]} parsed, but not returned yet */
  records = [];

  /** @param {Response} response @param {AbortController} abort */
  constructor(response, abort) {
    const { body } = response;
    if (body === null) throw new GoneError(GONE);
    /** @type {string | null} */ this.token = response.headers.get("Swings-Play");
    /** Time after which the server wants the next status report; 0: it does not say. @type {number} */
    this.reportMs = Number(response.headers.get("Swings-Report-Ms"));
    /** @type {AbortController} */ this.abort = abort;
    this.reader = body.getReader();
  }

  /**
   * Sends the request. Rejects with a GoneError, or with a SourceError if trying again would not help.
   * @param {import("./fetcher.js").Fetcher} fetcher
   * @param {string} base URL of the stream, with a trailing slash @param {PlayQuery} query
   * @param {AbortSignal} [signal] aborts the request and the response
   */
  static async open(fetcher, base, query, signal) {
    const { lastToken, rateBps, nextFrame } = query;
    const url = playUrl(base, query);
    const abort = new AbortController();
    signal?.addEventListener("abort", () => abort.abort(), { once: true });
    if (signal?.aborted) abort.abort();
    const headers = new Headers(lastToken ? { "Swings-Play": lastToken } : {});
    if (rateBps) headers.set("Swings-Rate", String(rateBps));
    if (typeof nextFrame === "number") headers.set("Swings-Frame", String(nextFrame));
    const request = { headers, signal: abort.signal, cache: /** @type {const} */ ("no-store") };
    const response = await fetcher.fetch(url, request).catch((/** @type {unknown} */ error) => {
      throw new GoneError(error instanceof SilentError ? SILENT : GONE, 0, error);
    });
    if (response.ok) return new PlayResponse(response, abort);
    discard(response);
    if (response.status < 500) throw new SourceError(`${base}: HTTP ${response.status}`);
    throw new GoneError(BUSY, Number(response.headers.get("Retry-After")) || 0);
  }

  /**
   * The next record; null at the end of the body. Rejects with a GoneError, or with a FormatError.
   * @param {() => void} [onBytes] called when `bodyBytes` may have grown
   * @returns {Promise<import("../constants.js").PlayRecord | null>}
   */
  async next(onBytes = () => {}) {
    while (this.records.length === 0) {
      const piece = await this.reader.read().catch((/** @type {unknown} */ error) => {
        throw new GoneError(GONE, 0, error);
      });
      if (piece.done) return null;
      this.#note(piece.value.length);
      this.records = this.parser.feed(piece.value);
    }
    onBytes();
    return this.records.shift() ?? null;
  }

  /** @param {number} numBytes that have come now */
  #note(numBytes) {
    this.bodyBytes += numBytes;
    const nowMs = Math.round(performance.now());
    const newest = this.points.push([nowMs, this.bodyBytes]) - 1;
    if (newest < MOST_POINTS) return;
    this.points = this.points.filter((_, n) => n % 2 === newest % 2);
  }

  /** The points since the last time, for a status report. */
  takePoints() {
    return this.points.splice(0);
  }

  /** Ends the response; `next` gives null from now on. */
  close() {
    this.reader.cancel().catch(() => {}); // it may have broken off itself
    this.abort.abort();
  }
}

/** @typedef {{ response: PlayResponse, start: import("../constants.js").StartRecord }} OpenedPlay */

/**
 * Opens a play, and reads its start record. Rejects like PlayResponse.open.
 * @param {import("./fetcher.js").Fetcher} fetcher @param {string} base @param {PlayQuery} query
 * @param {AbortSignal} [signal] aborts the play @returns {Promise<OpenedPlay>}
 */
export async function openPlay(fetcher, base, query, signal) {
  const response = await PlayResponse.open(fetcher, base, query, signal);
  let why = GONE;
  const stop = fetcher.watch(() => {
    why = SILENT;
    response.close();
  });
  const start = await response.next().finally(stop);
  if (start === null) throw new GoneError(why);
  if (start.kind !== "start") throw corrupt("play: the first record is not a start record");
  return { response, start };
}

/** Repeats requests to an unreachable server: the delays between tries, and when to give up. */
export class ServerRetry {
  /** The reason of the last failure. */
  why = GONE;
  /** Number of times in a row that the server has reported it. */
  reports = 0;
  tries = 0;
  sinceMs = 0;
  /** @type {SourceError | null} */
  refused = null;
  /** Whether the caller has ended, so that no further try is made. */
  isOver = false;

  /**
   * @param {import("./fetcher.js").Fetcher} fetcher its `giveUpS` and `onTrouble` are used
   * @param {string} base URL of the stream
   */
  constructor(fetcher, base) {
    this.fetcher = fetcher;
    /** @type {string} */ this.base = base;
  }

  /** To be called after a success: the trouble is over. */
  reset() {
    if (this.tries > 0) this.fetcher.onTrouble(null);
    this.tries = 0;
    this.reports = 0;
    this.refused = null;
  }

  /**
   * Notes an error that the server reports. Throws a SourceError if it does so again and again.
   * @param {string} message
   */
  noteReport(message) {
    const why = `The server reports: ${message}`;
    this.reports = why === this.why ? this.reports + 1 : 1;
    this.why = why;
    if (this.reports >= MOST_REPORTS) throw new SourceError(`${this.base}: ${why}`);
  }

  /**
   * Repeats `action` until it succeeds. Rejects with a SourceError after `giveUpS`, and at once with errors
   * other than a GoneError.
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
        console.debug(`${this.base}: ${this.why}`, error.cause);
        await this.wait(error.afterS);
      }
    }
  }

  /**
   * Reports the problem, and waits until the next try. Rejects with a SourceError after `giveUpS`.
   * @param {number} leastS
   */
  async wait(leastS = 0) {
    const { fetcher, base, why } = this;
    if (this.tries === 0) this.sinceMs = performance.now();
    this.tries += 1;
    if (why === GONE && this.tries >= TRIES_BEFORE_DOUBT) {
      if (this.refused) throw this.refused;
      this.refused = await fetcher.findRefusal(base);
      if (this.refused) return; // once more, since the network may be back
    }
    if (performance.now() - this.sinceMs > 1000 * fetcher.giveUpS) {
      throw new SourceError(
        why === GONE
          ? `${base} cannot be reached; check the network and try again`
          : `${base}: ${why}`,
      );
    }
    fetcher.onTrouble(`${why}; trying again`);
    const restS = Math.max(delayS(this.tries), Math.min(leastS, fetcher.giveUpS));
    await rest(restS);
  }
}
