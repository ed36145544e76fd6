import { checkGaussians, readManifest, snapshotOf } from "../format/manifest.js";
import { CODERS, SKIPPABLE_MAGIC } from "../constants.js";
import { limitBytes } from "../format/packet.js";
import { FIRST_PLAY } from "./addresses.js";
import { REPLACED, SourceError } from "./fetcher.js";
import { openPlay, ServerRetry } from "./playresponse.js";
import { SegmentCache } from "./segmentcache.js";
import { ServedPlay } from "./servedplay.js";

/** Seconds until a stream without frames is requested again. */
const RETRY_S = 1;
/** Bytes of an object in addition to its packet: the table. */
const TABLE_BYTES = 32;

/** @typedef {import("./playresponse.js").PlayResponse} PlayResponse */

/** A stream of a swings server, which itself chooses what to send when. */
export class ServedStream {
  /**
   * @param {string} base
   * @param {import("./fetcher.js").Fetcher} fetcher
   * @param {import("./playresponse.js").OpenedPlay} first
   * @param {number} [bufferBytes] limit for the received data that is kept
   */
  constructor(base, fetcher, first, bufferBytes) {
    this.base = base;
    this.fetcher = fetcher;
    this.manifest = readManifest(first.start.manifest);
    this.description = describe(first.start.manifest);
    this.numFrames = first.start.numFrames;
    this.cache = new SegmentCache(this.manifest, bufferBytes);
    /** @type {boolean | null} whether the server's objects have a form that this browser can read, if known */
    this.hasObjects = null;
    /** @type {PlayResponse | null} the first response, for a play that begins at the same frame */
    this.first = first.response;
    /** @type {string | null} token of the last play, by which the server finds what it knows of the link */
    this.lastToken = first.response.token;
    /** @type {number | null} the server's last reported estimate of the link's throughput */
    this.rateBps = null;
    /** Bytes on the network for each byte of a play, which has a content coding. */
    this.networkShare = 1;
    this.onGrown = () => {};
  }

  /**
   * Opens a play from the first frame on; waits for the first frames of a live stream. Rejects with a
   * SourceError or a FormatError.
   * @param {string} base URL of the stream, with a trailing slash
   * @param {import("./fetcher.js").Fetcher} fetcher
   * @param {number | null} maxGaussians see `checkGaussians`
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
    return new ServedPlay(this, request);
  }

  /** Current number of frames of a segment. @param {number} segment */
  framesIn(segment) {
    const { segmentFrames } = this.manifest;
    return Math.max(0, Math.min(segmentFrames, this.numFrames - segment * segmentFrames));
  }

  /**
   * Fetches the snapshot of a layer into the cache; returns whether it is there. Rejects with a
   * SourceError, a GoneError or a FormatError, or if `signal` aborts.
   * @param {number} segment
   * @param {number} layer
   * @param {AbortSignal} signal
   */
  async fetchSnapshot(segment, layer, signal) {
    const { manifest } = this;
    const frame = segment * manifest.segmentFrames;
    const part = snapshotOf(manifest, layer);
    if (this.hasObjects !== false) {
      const packet = await this.#snapshotObject(segment, part, signal);
      if (packet !== null) this.cache.add(frame, part, packet);
      this.hasObjects = packet !== null;
    }
    // A browser that cannot read the server's objects gets layer 0 from the first records of a play.
    if (!this.hasObjects && layer === 0) await this.#playSnapshot(frame, signal);
    return this.cache.snapshot(segment, layer) !== null;
  }

  /**
   * The packet of a snapshot, or its chunk; null if the server sends the stored object of coder zstd.
   * @param {number} segment
   * @param {import("../format/manifest.js").Part} part
   * @param {AbortSignal} signal
   */
  async #snapshotObject(segment, part, signal) {
    const { base, manifest } = this;
    const most = limitBytes(manifest, part) + TABLE_BYTES;
    const url = `${base}segments/${segment}/${manifest.parts[part]}`;
    const bytes = await this.fetcher.get(url, most, undefined, { signal });
    const magic = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
    if (bytes.length < 4 || magic.getUint32(0, true) !== SKIPPABLE_MAGIC) return bytes;
    const { readObject } = await import("../format/objecttable.js");
    const { coder, packets } = readObject(bytes);
    return coder === CODERS.GZIP ? (packets.values().next().value ?? null) : null;
  }

  /**
   * @param {number} frame first of a segment
   * @param {AbortSignal} signal
   */
  async #playSnapshot(frame, signal) {
    const query = { fromFrame: frame, untilFrame: frame + 1, layers: 1, paused: true };
    const { response } = await openPlay(this.fetcher, this.base, query, signal);
    for (;;) {
      const record = await response.next(() => this.count(response));
      if (record === null || record.kind === "end" || record.kind === "error") return;
      if (record.kind !== "snapshot" || record.frame !== frame || record.firstLayer > 0) continue;
      this.cache.add(frame, snapshotOf(this.manifest, 0), record.packets[0]);
    }
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
    const numBytes = Math.round(response.bodyBytes * this.networkShare);
    this.fetcher.receivedBytes += numBytes - response.countedBytes;
    response.countedBytes = numBytes;
  }

  /** Calls `onGrown` when a play reports that the stream has grown. @param {() => void} onGrown */
  async follow(onGrown) {
    this.onGrown = onGrown;
  }

  /**
   * Notes that the stream has at least `numFrames` frames.
   * @param {number} numFrames
   * @param {boolean} live whether more frames may follow
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
