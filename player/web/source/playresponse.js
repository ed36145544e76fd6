import { RecordParser } from "../format/playrecord.js";
import { SourceError } from "./fetcher.js";

/** The server is gone, or has no time; it may be back soon. */
export class GoneError extends Error {
  /** @param {number} afterS not to be tried again before so many seconds */
  constructor(afterS = 0) {
    super("The server is gone");
    this.name = "GoneError";
    this.afterS = afterS;
  }
}

const NOT_THERE = [404, 410];

/** One response of a swings server to `play?plain=1`, record by record (FORMAT.md, section 10). */
export class PlayResponse {
  /**
   * @param {Response} response
   * @param {AbortController} abort
   */
  constructor(response, abort) {
    const { body } = response;
    if (body === null) throw new GoneError();
    this.token = response.headers.get("Swings-Play");
    this.abort = abort;
    this.reader = body.getReader();
    this.parser = new RecordParser();
    /** @type {import("../format/playrecord.js").PlayRecord[]} parsed, but not handed out */
    this.records = [];
    this.receivedBytes = 0;
  }

  /**
   * Rejects with a GoneError, or with a SourceError if trying again would not help.
   * @param {string} base URL of the stream, with a slash at its end
   * @param {{ fromFrame: number, layers: number | null, lastToken: string | null }} wish
   *   layers: null for the server's choice; lastToken: of the play before this one
   */
  static async open(base, { fromFrame, layers, lastToken }) {
    const url = `${base}play?plain=1&from=${fromFrame}${layers === null ? "" : `&layers=${layers}`}`;
    const abort = new AbortController();
    const headers = /** @type {HeadersInit} */ (lastToken ? { "Swings-Play": lastToken } : {});
    let response;
    try {
      response = await fetch(url, { headers, signal: abort.signal, cache: "no-store" });
    } catch {
      throw new GoneError();
    }
    if (response.status >= 500) throw new GoneError(Number(response.headers.get("Retry-After")));
    if (NOT_THERE.includes(response.status)) {
      throw new SourceError(`${base} is not a stream of this server (HTTP ${response.status})`);
    }
    if (!response.ok) throw new SourceError(`${url}: HTTP ${response.status}`);
    return new PlayResponse(response, abort);
  }

  /**
   * The next record; null at the end of the body. Rejects with a GoneError, or with a FormatError.
   * @returns {Promise<import("../format/playrecord.js").PlayRecord | null>}
   */
  async next() {
    while (this.records.length === 0) {
      let piece;
      try {
        piece = await this.reader.read();
      } catch {
        throw new GoneError();
      }
      if (piece.done) return null;
      this.receivedBytes += piece.value.length;
      this.records = this.parser.feed(piece.value);
    }
    return this.records.shift() ?? null;
  }

  close() {
    this.abort.abort();
  }
}
