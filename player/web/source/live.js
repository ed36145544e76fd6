/** The index of a stream that may grow, and how it is followed. */

import { MAX_INDEX_BYTES } from "../constants.js";
import { FormatError } from "../format/bytes.js";
import { readIndex, recordBytes } from "../format/objects.js";
import { Fetcher, REPLACED, SourceError } from "./fetcher.js";
import { followPeriodS } from "./liveedge.js";

/** The index of a stream that may grow. */
export class GrowingIndex {
  /**
   * @param {string} url @param {import("./fetcher.js").Fetcher} fetcher
   * @param {import("../format/manifest.js").Manifest} manifest
   */
  constructor(url, fetcher, manifest) {
    this.url = url;
    this.fetcher = fetcher;
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
    if (known >= 0 && !isSame(found[known - first], records[known])) {
      throw new SourceError(REPLACED);
    }
    const fresh = found.slice(known + 1 - first);
    records.push(...fresh);
    return fresh;
  }
}

/**
 * The error to report for `error` of a stream: that it was replaced, if it was.
 * @param {GrowingIndex} index @param {unknown} error
 */
export async function explained({ url, fetcher, manifest, records }, error) {
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
 * @param {import("./hosted.js").HostedStream} stream
 * @param {() => void} onGrown called when the stream has more frames, or has ended
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
