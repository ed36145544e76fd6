import { MAX_MANIFEST_BYTES } from "../constants.js";
import { corrupt } from "../format/bytes.js";
import { checkGaussians, readManifest, keyframeOf } from "../format/manifest.js";
import { readObject } from "../format/objects.js";
import { fileUrl } from "./addresses.js";
import { addObject } from "./cachedobjects.js";
import { SourceError } from "./fetcher.js";
import { objectPath, objectUrl } from "./files.js";
import { HostedDownload, RateEstimator, RequestWindow, watchCache } from "./hosteddownload.js";
import { explained, follow, GrowingIndex } from "./live.js";
import { followPeriodS } from "./liveedge.js";
import { SegmentCache } from "./segmentcache.js";

/** A stream of files on any static host. It fetches whole objects, see LayerRule. */
export class HostedStream {
  estimator = new RateEstimator();
  /** Whether the last play is paused. */
  isPaused = false;
  window = new RequestWindow();
  /** @type {Map<string, unknown>} errors of objects of layers above 0, by segment and part */
  absent = new Map();

  /**
   * @param {string} base URL of the folder, with a trailing slash
   * @param {import("./fetcher.js").Fetcher} fetcher
   * @param {import("../format/manifest.js").Manifest} manifest
   * @param {boolean} otherHosts whether objects may be on other hosts than the manifest
   * @param {number} [bufferBytes] limit for the received data that is kept
   */
  constructor(base, fetcher, manifest, otherHosts, bufferBytes) {
    this.base = base;
    this.otherHosts = otherHosts;
    this.fetcher = fetcher;
    this.manifest = manifest;
    this.cache = new SegmentCache(manifest, bufferBytes);
    this.index = new GrowingIndex(fileUrl("index.bin", base), fetcher, manifest);
    watchCache((numBytes) => this.estimator.remove(numBytes));
  }

  /**
   * Reads manifest and index; waits for the first frames of a live stream. Rejects with a SourceError
   * or a FormatError.
   * @param {string} base @param {import("./fetcher.js").Fetcher} fetcher
   * @param {number | null} maxGaussians see `checkGaussians`
   * @param {boolean} otherHosts whether objects may be on other hosts than the manifest
   * @param {number} [bufferBytes] limit for the received data that is kept
   */
  static async open(base, fetcher, maxGaussians = null, otherHosts = false, bufferBytes) {
    const manifest = await fetchManifest(base, fetcher);
    checkGaussians(manifest, maxGaussians, base);
    const stream = new HostedStream(base, fetcher, manifest, otherHosts, bufferBytes);
    await stream.index.refresh();
    if (stream.numFrames > 0) return stream;
    while (stream.manifest.live && stream.numFrames === 0) {
      fetcher.awaitFrames(base, stream.manifest);
      await new Promise((resolve) => setTimeout(resolve, 1000 * followPeriodS(stream.manifest)));
      await stream.refresh();
    }
    fetcher.onTrouble(null);
    if (stream.numFrames === 0) throw new SourceError(`${base} ended before its first frame`);
    return stream;
  }

  /** Updates a live stream; returns whether it has grown or ended. Rejects like `open`. */
  async refresh() {
    // The manifest is read before the index, so that a finished manifest implies a complete index.
    const { live } = await fetchManifest(this.base, this.fetcher);
    const fresh = await this.index.refresh();
    const hasEnded = this.manifest.live && !live;
    this.manifest = { ...this.manifest, live };
    return hasEnded || fresh.length > 0;
  }

  /** @param {import("./source.js").PlayRequest} request */
  play(request) {
    return new HostedDownload(this, request);
  }

  /**
   * Fetches the keyframe of a layer into the cache. Rejects with a SourceError or a FormatError, or if
   * `signal` aborts.
   * @param {number} segment @param {number} layer @param {AbortSignal} signal
   */
  async fetchKeyframe(segment, layer, signal) {
    const record = this.records[segment];
    const part = keyframeOf(this.manifest, layer);
    const packets = await this.object(record, part, () => {}, signal);
    addObject(this.cache, record, part, packets);
  }

  /** The error to report for `error`. @param {unknown} error */
  async explain(error) {
    return explained(this.index, error);
  }

  /** Follows the stream while it grows. @param {() => void} onGrown */
  follow(onGrown) {
    return follow(this, onGrown);
  }

  get records() {
    return this.index.records;
  }

  get numFrames() {
    const last = this.records.at(-1);
    return last === undefined ? 0 : last.firstFrame + last.numFrames;
  }

  /**
   * The packets of an object. Rejects with a SourceError or a FormatError.
   * @param {import("../format/objects.js").SegmentRecord} record
   * @param {import("../format/manifest.js").Part} part @param {(numBytes: number) => void} onBytes
   * @param {AbortSignal} [signal]
   */
  async object(record, part, onBytes, signal) {
    const size = record.objectBytes[part];
    const { url, bytes } = await this.objectBytes(record, part, onBytes, signal);
    if (bytes.length !== size)
      throw corrupt(`${url} has ${bytes.length} bytes, but the index says ${size}`);
    return readObject(bytes);
  }

  /** Places of pictures, captions and sound in a packed stream; null: they are beside the manifest. */
  get files() {
    return /** @type {Record<string, import("./packed.js").Place> | null} */ (null);
  }

  /**
   * The bytes of an object, and its name in error messages.
   * @param {import("../format/objects.js").SegmentRecord} record
   * @param {import("../format/manifest.js").Part} part @param {(numBytes: number) => void} onBytes
   * @param {AbortSignal} [signal]
   */
  async objectBytes(record, part, onBytes, signal) {
    const { manifest } = this;
    const path = objectPath(manifest, record.segment, manifest.parts[part]);
    const url = objectUrl(this.base, path, this.otherHosts);
    const size = record.objectBytes[part];
    return { url, bytes: await this.fetcher.get(url, size, onBytes, { signal }) };
  }
}

/**
 * The current manifest. Rejects with a SourceError or a FormatError.
 * @param {string} base @param {import("./fetcher.js").Fetcher} fetcher
 */
async function fetchManifest(base, fetcher) {
  const init = /** @type {RequestInit} */ ({ cache: "no-cache" });
  return readManifest(
    await fetcher.get(fileUrl("manifest.json", base), MAX_MANIFEST_BYTES, undefined, init),
  );
}
