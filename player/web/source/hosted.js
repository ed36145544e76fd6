import { MAX_INDEX_BYTES, MAX_MANIFEST_BYTES } from "../constants.js";
import { corrupt, FormatError } from "../format/bytes.js";
import { checkGaussians, keyframeOf, readManifest } from "../format/manifest.js";
import { readIndex, readObject, recordBytes } from "../format/objects.js";
import { fileUrl } from "./addresses.js";
import { Fetcher, REPLACED, SourceError } from "./fetcher.js";
import { objectPath, objectUrl } from "./files.js";
import {
  addObject,
  HostedDownload,
  RateEstimator,
  RequestWindow,
  watchCache,
} from "./hosteddownload.js";
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
   * @param {Fetcher} fetcher @param {import("../format/manifest.js").Manifest} manifest
   * @param {boolean} otherHosts whether objects may be on other hosts than the manifest
   * @param {number} [bufferBytes] limit for the received data that is kept
   */
  constructor(base, fetcher, manifest, otherHosts, bufferBytes) {
    /** @type {string} */ this.base = base;
    /** @type {boolean} */ this.otherHosts = otherHosts;
    this.fetcher = fetcher;
    this.manifest = manifest;
    this.cache = new SegmentCache(manifest, bufferBytes);
    this.index = new GrowingIndex(fileUrl("index.bin", base), fetcher, manifest);
    watchCache((numBytes) => this.estimator.remove(numBytes));
  }

  /**
   * Reads manifest and index; waits for the first frames of a live stream. Rejects with a SourceError or a
   * FormatError.
   * @param {string} base @param {Fetcher} fetcher @param {number | null} maxGaussians see `checkGaussians`
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
 * @param {string} base @param {Fetcher} fetcher
 */
async function fetchManifest(base, fetcher) {
  const init = /** @type {RequestInit} */ ({ cache: "no-cache" });
  return readManifest(
    await fetcher.get(fileUrl("manifest.json", base), MAX_MANIFEST_BYTES, undefined, init),
  );
}

/** The index of a stream that may grow. */
export class GrowingIndex {
  /** @param {string} url @param {Fetcher} fetcher @param {import("../format/manifest.js").Manifest} manifest */
  constructor(url, fetcher, manifest) {
    /** @type {string} */ this.url = url;
    /** @type {Fetcher} */ this.fetcher = fetcher;
    this.manifest = manifest;
    /** @type {import("../format/objects.js").SegmentRecord[]} records of all known segments */
    this.records = [];
  }

  /**
   * Fetches the records that were appended since the last call, adds them and returns them. Rejects with
   * a SourceError or a FormatError, and is then unchanged.
   */
  async refresh() {
    const { url, manifest, records } = this;
    const known = records.length - 1;
    /** @type {RequestInit} */
    const init = { cache: "no-store" };
    // The range starts with the last known record. That record tells a range from a whole file, which
    // some hosts send anyway, and this stream from another one.
    if (known > 0) init.headers = { Range: `bytes=${known * recordBytes(manifest)}-` };
    const bytes = await this.fetcher.get(url, MAX_INDEX_BYTES, undefined, init);
    const isRange = known > 0 && bytes.length >= 4 && firstSegment(bytes) === known;
    const first = isRange ? known : 0;
    const found = readIndex(bytes, manifest, first);
    if (known >= 0 && !isSame(found[known - first], records[known]))
      throw new SourceError(REPLACED);
    const fresh = found.slice(known + 1 - first);
    records.push(...fresh);
    return fresh;
  }
}

/**
 * The error to report for `error` of a stream: that it was replaced, if it was.
 * @param {GrowingIndex} index @param {unknown} error
 */
async function explained({ url, fetcher, manifest, records }, error) {
  // Where there is no network, `error` says so already.
  const now = new GrowingIndex(url, new Fetcher({ ...fetcher.access, giveUpS: 0 }), manifest);
  try {
    await now.refresh();
  } catch (other) {
    // A stream of other layers has records of another size.
    return other instanceof FormatError ? new SourceError(REPLACED) : error;
  }
  const last = records.length - 1;
  return isSame(now.records[last], records[last]) ? error : new SourceError(REPLACED);
}

/** @param {Uint8Array} bytes */
function firstSegment(bytes) {
  return new DataView(bytes.buffer, bytes.byteOffset).getUint32(0, true);
}

/**
 * Whether a segment is the one that it was.
 * @param {import("../format/objects.js").SegmentRecord | undefined} found
 * @param {import("../format/objects.js").SegmentRecord} known
 */
export function isSame(found, known) {
  const [hash] = found?.objectSha256 ?? [];
  return hash !== undefined && hash.every((byte, i) => byte === known.objectSha256[0][i]);
}

/** Errors of a host are tolerated for this time, for example while its files are replaced. */
const TOLERATED_S = 60;
/** Seconds between two checks while the stream is paused: its edge stays known closely enough to count as live. */
const PAUSED_PERIOD_S = 2.5;

/**
 * Follows a live stream until it has ended. Rejects with the host's error if that lasts.
 * @param {HostedStream} stream @param {() => void} onGrown called when the stream has more frames, or has ended
 */
export async function follow(stream, onGrown) {
  let goodMs = performance.now();
  while (stream.manifest.live) {
    const periodS = followPeriodS(stream.manifest);
    let waitedS = 0;
    do {
      await new Promise((resolve) => setTimeout(resolve, 1000 * periodS));
      waitedS += periodS;
    } while (stream.isPaused && waitedS < PAUSED_PERIOD_S);
    try {
      const isNew = await stream.refresh();
      goodMs = performance.now();
      if (isNew) onGrown();
    } catch (error) {
      console.warn(`The stream could not be looked for: ${error}`);
      if (performance.now() - goodMs > 1000 * TOLERATED_S) throw error;
    }
  }
}
