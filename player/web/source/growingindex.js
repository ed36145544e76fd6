import { MAX_INDEX_BYTES } from "../constants.js";
import { readIndex, recordBytes } from "../format/streamindex.js";
import { SourceError } from "./fetcher.js";

/** The index of a stream that may grow. */
export class GrowingIndex {
  /**
   * @param {string} url
   * @param {import("./fetcher.js").Fetcher} fetcher
   * @param {import("../format/manifest.js").Manifest} manifest
   */
  constructor(url, fetcher, manifest) {
    this.url = url;
    this.fetcher = fetcher;
    this.manifest = manifest;
    /** @type {import("../format/streamindex.js").SegmentRecord[]} records of all known segments */
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
      throw new SourceError(`${url} now belongs to another stream; reload the page`);
    }
    const fresh = found.slice(known + 1 - first);
    records.push(...fresh);
    return fresh;
  }
}

/** @param {Uint8Array} bytes */
function firstSegment(bytes) {
  return new DataView(bytes.buffer, bytes.byteOffset).getUint32(0, true);
}

/**
 * @param {import("../format/streamindex.js").SegmentRecord | undefined} found
 * @param {import("../format/streamindex.js").SegmentRecord} known
 */
function isSame(found, known) {
  const [hash] = found?.objectSha256 ?? [];
  return hash !== undefined && hash.every((byte, i) => byte === known.objectSha256[0][i]);
}
