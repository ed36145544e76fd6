import { FIRST_PACKED_BYTES } from "../constants.js";
import { corrupt, FormatError } from "../format/bytes/errors.js";
import { checkGaussians, readManifest } from "../format/manifest.js";
import { PackedLayout, readPackedHead } from "../format/packedlayout.js";
import { readIndex } from "../format/streamindex.js";
import { fetchRange } from "./byteranges.js";
import { Fetcher, REPLACED, SourceError } from "./fetcher.js";
import { isSame } from "./growingindex.js";
import { HostedStream } from "./hosted.js";

/** @typedef {import("../format/packedlayout.js").Place} Place */

/** A stream in one file on any static host that supports ranges. */
export class PackedStream extends HostedStream {
  /**
   * @param {string} url
   * @param {import("./fetcher.js").Fetcher} fetcher
   * @param {PackedLayout} layout
   * @param {number | null} fileBytes null if the host hides it
   * @param {number} [bufferBytes] limit for the received data that is kept
   */
  constructor(url, fetcher, layout, fileBytes, bufferBytes) {
    super(url, fetcher, layout.manifest, false, bufferBytes);
    this.layout = layout;
    this.fileBytes = fileBytes;
    this.index.records = layout.records;
  }

  /**
   * Reads the beginning of the file, with one or two requests. Rejects with a SourceError or a
   * FormatError.
   * @override
   * @param {string} url
   * @param {import("./fetcher.js").Fetcher} fetcher
   * @param {number | null} maxGaussians see `checkGaussians`
   * @param {boolean} [_otherHosts] unused, because everything is in the file
   * @param {number} [bufferBytes] limit for the received data that is kept
   */
  static async open(url, fetcher, maxGaussians = null, _otherHosts = false, bufferBytes) {
    const first = await fetchRange(fetcher, url, { first: 0, size: FIRST_PACKED_BYTES });
    const { fileBytes } = first;
    const head = readPackedHead(first.bytes);
    const end = head.tracks.first + head.tracks.size;
    let { bytes } = first;
    if (end > bytes.length) {
      const missing = { first: bytes.length, size: end - bytes.length };
      const rest = await fetchRange(fetcher, url, missing);
      if (rest.bytes.length !== missing.size || rest.fileBytes !== fileBytes)
        throw corrupt(`${url} ends before its index`);
      bytes = new Uint8Array(end);
      bytes.set(first.bytes);
      bytes.set(rest.bytes, missing.first);
    }
    const part = (/** @type {Place} */ place) =>
      bytes.subarray(place.first, place.first + place.size);
    const manifest = readManifest(part(head.manifest));
    checkGaussians(manifest, maxGaussians, url);
    if (manifest.live) throw corrupt(`${url}: a packed stream is never live`);
    const records = readIndex(part(head.index), manifest);
    const layout = new PackedLayout(head, manifest, records, part(head.tracks));
    if (fileBytes !== null && fileBytes < layout.endByte)
      throw corrupt(`${url} has ${fileBytes} bytes, but its objects end at ${layout.endByte}`);
    if (layout.records.length === 0) throw corrupt(`${url} has no frames`);
    return new PackedStream(url, fetcher, layout, fileBytes, bufferBytes);
  }

  /** @override A file of another size is noticed at once, one of the same size here. @param {unknown} error */
  async explain(error) {
    const known = this.layout.records;
    try {
      const fetcher = new Fetcher({ ...this.fetcher.access, giveUpS: 0 });
      const { layout } = await PackedStream.open(this.base, fetcher, Infinity);
      const last = known.length - 1;
      return isSame(layout.records[last], known[last]) ? error : new SourceError(REPLACED);
    } catch (other) {
      return other instanceof FormatError ? new SourceError(REPLACED) : error;
    }
  }

  /** @override */
  get files() {
    return this.layout.files;
  }

  /**
   * @override
   * @param {import("../format/streamindex.js").SegmentRecord} record
   * @param {import("../format/manifest.js").Part} part
   * @param {(numBytes: number) => void} onBytes
   * @param {AbortSignal} [signal]
   */
  async objectBytes(record, part, onBytes, signal) {
    const place = this.layout.object(record, part);
    const { bytes, fileBytes } = await fetchRange(this.fetcher, this.base, place, onBytes, {
      signal,
    });
    if (this.fileBytes !== fileBytes) throw new SourceError(REPLACED);
    const name = this.manifest.parts[part];
    return { url: `${this.base}, segment ${record.segment}, ${name},`, bytes };
  }
}
