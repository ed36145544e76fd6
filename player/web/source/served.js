import { checkGaussians, readManifest } from "../format/manifest.js";
import { FIRST_PLAY } from "./addresses.js";
import { REPLACED, SourceError } from "./fetcher.js";
import { openPlay, ServerRetry } from "./playresponse.js";
import { SegmentCache } from "./segmentcache.js";
import { ServedDownload } from "./serveddownload.js";

/** Seconds until a stream without frames is requested again. */
const RETRY_S = 1;

/** @typedef {import("./playresponse.js").PlayResponse} PlayResponse */

/** A stream of a swings server, which itself chooses what to send when. */
export class ServedStream {
  /** @type {number | null} the server's last reported estimate of the link's throughput */
  rateBps = null;
  onGrown = () => {};

  /**
   * @param {string} base @param {import("./fetcher.js").Fetcher} fetcher
   * @param {import("./playresponse.js").OpenedPlay} first
   * @param {number} [bufferBytes] limit for the received data that is kept
   */
  constructor(base, fetcher, first, bufferBytes) {
    /** @type {string} */ this.base = base;
    this.fetcher = fetcher;
    this.manifest = readManifest(first.start.manifest);
    /** @type {string} */ this.description = describe(first.start.manifest);
    /** @type {number} */ this.numFrames = first.start.numFrames;
    this.cache = new SegmentCache(this.manifest, bufferBytes);
    /** @type {PlayResponse | null} the first response, for a play that begins at the same frame */
    this.first = first.response;
    /** @type {string | null} token of the last play, by which the server finds what it knows of the link */
    this.lastToken = first.response.token;
  }

  /**
   * Opens a play from the first frame on; waits for the first frames of a live stream. Rejects with a
   * SourceError or a FormatError.
   * @param {string} base URL of the stream, with a trailing slash
   * @param {import("./fetcher.js").Fetcher} fetcher @param {number | null} maxGaussians see `checkGaussians`
   * @param {number} [bufferBytes] limit for the received data that is kept
   */
  static async open(base, fetcher, maxGaussians = null, bufferBytes) {
    const retry = new ServerRetry(fetcher, base);
    for (;;) {
      const opened = await retry.begin(() => openPlay(fetcher, base, FIRST_PLAY));
      const stream = new ServedStream(base, fetcher, opened, bufferBytes);
      try {
        checkGaussians(stream.manifest, maxGaussians, base);
      } catch (error) {
        stream.first?.close();
        throw error;
      }
      if (stream.numFrames > 0) return stream;
      stream.first?.close();
      if (!stream.manifest.live) throw new SourceError(`${base} ended before its first frame`);
      fetcher.awaitFrames(base, stream.manifest);
      await new Promise((resolve) => setTimeout(resolve, 1000 * RETRY_S));
    }
  }

  /** Null: pictures, captions and sound are beside the manifest. */
  get files() {
    return null;
  }

  /** @param {import("./source.js").PlayRequest} request */
  play(request) {
    return new ServedDownload(this, request);
  }

  /** Current number of frames of a segment. @param {number} segment */
  framesIn(segment) {
    const { segmentFrames } = this.manifest;
    return Math.max(0, Math.min(segmentFrames, this.numFrames - segment * segmentFrames));
  }

  /**
   * Fetches the keyframe of a layer into the cache. Rejects with a SourceError or a FormatError, or if
   * `signal` aborts.
   * @param {number} segment @param {number} layer @param {AbortSignal} signal
   */
  async fetchKeyframe(segment, layer, signal) {
    const { fetchKeyframe } = await import("./servedkeyframe.js");
    return fetchKeyframe(this, segment, layer, signal);
  }

  /** Throws a SourceError if a play is of another stream. @param {Uint8Array} manifest of its start */
  checkSame(manifest) {
    if (describe(manifest) !== this.description) throw new SourceError(REPLACED);
  }

  /** The error to report for `error`. @param {unknown} error */
  async explain(error) {
    return error;
  }

  /** Adds what has come of a response to the received bytes. @param {PlayResponse} response */
  count(response) {
    this.fetcher.heard();
    this.fetcher.receivedBytes += response.bodyBytes - response.countedBytes;
    response.countedBytes = response.bodyBytes;
  }

  /** Calls `onGrown` when a play reports that the stream has grown. @param {() => void} onGrown */
  async follow(onGrown) {
    this.onGrown = onGrown;
  }

  /**
   * Notes that the stream has at least `numFrames` frames.
   * @param {number} numFrames @param {boolean} live whether more frames may follow
   */
  grow(numFrames, live) {
    if (numFrames <= this.numFrames && live === this.manifest.live) return;
    this.numFrames = Math.max(this.numFrames, numFrames);
    this.manifest = { ...this.manifest, live };
    this.onGrown();
  }
}

/** A manifest but for its `live`, which changes. @param {Uint8Array} manifest as JSON */
function describe(manifest) {
  return new TextDecoder().decode(manifest).replace(/"live": *(true|false)/, "");
}
