/** A packed stream: one file with all files of a stream; its beginning determines their places. */

import {
  FIRST_PACKED_BYTES,
  MAX_CAPTIONS,
  MAX_INDEX_BYTES,
  MAX_MANIFEST_BYTES,
  MAX_PICTURE_BYTES,
  MAX_SOURCES,
  PACKED_EXTRA,
  PACKED_EXTRA_ID,
  PACKED_VERSION,
  SOUND_PREFIX,
  ZIP_LOCAL,
  ZIP_LOCAL_MAGIC,
} from "../constants.js";
import { ByteReader, corrupt, FormatError, isMagic, unsupported } from "../format/bytes.js";
import { checkGaussians, skipMapsOf, readManifest, keyframeOf } from "../format/manifest.js";
import { readIndex } from "../format/objects.js";
import { Fetcher, REPLACED, SourceError } from "./fetcher.js";
import { fetchRange } from "./files.js";
import { HostedStream, isSame } from "./hosted.js";

const MANIFEST_NAME = "manifest.json";
const INDEX_NAME = "index.bin";
/** Bytes of a local header without the name, of the manifest's extra field, and of the whole header of `.tracks`. */
const [LOCAL_BYTES, EXTRA_BYTES, TRACKS_LOCAL_BYTES] = [30, 24, 37];

/**
 * A byte range of the file.
 * @typedef {object} Place
 * @property {number} first @property {number} size
 */

/**
 * The sizes that are stored only at the beginning of the file.
 * @typedef {object} PackedHead
 * @property {Place} manifest @property {Place} index
 * @property {Place} tracks the table of the sizes of captions and sound; empty without any
 * @property {number} posterBytes 0 for none
 * @property {number} storyboardBytes 0 for none, or if the storyboard is the poster
 */

/** The size of the local header of a file. @param {string} name */
function localBytes(name) {
  return LOCAL_BYTES + new TextEncoder().encode(name).length;
}

/**
 * Reads the beginning of a packed stream. Throws a FormatError.
 * @param {Uint8Array} bytes the first bytes of the file @returns {PackedHead}
 */
function readPackedHead(bytes) {
  const reader = new ByteReader(bytes, "packed stream");
  const local = reader.unpack(ZIP_LOCAL);
  const [magic] = local;
  const [storedBytes, manifestBytes, nameBytes, extraBytes] = local.slice(-4);
  const name = reader.take(MANIFEST_NAME.length);
  const [id, following, version, reserved, ...sizes] = reader.unpack(PACKED_EXTRA);
  const [indexBytes, posterBytes, storyboardBytes, tracksBytes] = sizes;
  const isPacked =
    magic === ZIP_LOCAL_MAGIC &&
    nameBytes === MANIFEST_NAME.length &&
    isMagic(name, MANIFEST_NAME) &&
    id === PACKED_EXTRA_ID &&
    following === extraBytes - 4;
  if (!isPacked) throw corrupt("packed stream: does not begin as one; make it with swings-stream");
  if (version !== PACKED_VERSION || reserved !== 0)
    throw unsupported(`packed stream: layout ${version}, not ${PACKED_VERSION}; pack it anew`);
  if (extraBytes !== EXTRA_BYTES) throw corrupt("packed stream: a head of another length");
  if (manifestBytes !== storedBytes || !(manifestBytes > 0 && manifestBytes <= MAX_MANIFEST_BYTES))
    throw corrupt(`packed stream: a manifest of ${manifestBytes} bytes`);
  if (!(indexBytes > 0 && Math.max(indexBytes, tracksBytes) <= MAX_INDEX_BYTES))
    throw corrupt(`packed stream: an index of ${indexBytes} bytes`);
  if (Math.max(posterBytes, storyboardBytes) > MAX_PICTURE_BYTES)
    throw corrupt("packed stream: too large a picture");
  const manifestAt = localBytes(MANIFEST_NAME) + extraBytes;
  const indexAt = manifestAt + manifestBytes + localBytes(INDEX_NAME);
  const tracksAt = indexAt + indexBytes + (tracksBytes ? TRACKS_LOCAL_BYTES : 0);
  return {
    manifest: { first: manifestAt, size: manifestBytes },
    index: { first: indexAt, size: indexBytes },
    tracks: { first: tracksAt, size: tracksBytes },
    posterBytes,
    storyboardBytes,
  };
}

/** @param {import("../format/objects.js").SegmentRecord} record @param {string} name of an object */
const pathOf = ({ segment }, name) => `segments/${segment}/${name}`;

/**
 * The names in a list of the manifest, which the page checks.
 * @param {unknown} value @param {string} key @param {number} most
 */
function names(value, key, most) {
  const found = /** @type {(Record<string, string> | null)[]} */ ([value ?? []].flat());
  if (found.length > most) throw corrupt(`manifest: ${found.length} tracks, at most ${most}`);
  return found.map((one) => one?.[key]);
}

/** The places of all other files. */
class PackedLayout {
  /**
   * @param {PackedHead} head @param {import("../format/manifest.js").Manifest} manifest
   * @param {import("../format/objects.js").SegmentRecord[]} records @param {Uint8Array} tracks the table of sizes
   */
  constructor(head, manifest, records, tracks) {
    this.manifest = manifest;
    this.records = records;
    const layers = [...Array(manifest.numLayers).keys()];
    /** In the order of a segment: the parts that a player of n layers needs are adjacent. @type {number[]} */
    this.parts = [
      ...layers.map((layer) => keyframeOf(manifest, layer)).reverse(),
      skipMapsOf(manifest),
      ...layers,
    ];
    const sources = names(manifest.sound, "name", MAX_SOURCES);
    const sizes = new ByteReader(tracks, "packed stream");
    let at = head.tracks.first + head.tracks.size;
    /** @type {Record<string, Place>} pictures, captions and sound by path */
    this.files = {};
    const add = (/** @type {string} */ path, /** @type {number} */ size) => {
      at += localBytes(path);
      this.files[path] = { first: at, size };
      at += size;
    };
    const { poster } = manifest;
    const storyboard = manifest.storyboard === poster ? null : manifest.storyboard;
    for (const [path, size] of /** @type {[string | null, number][]} */ ([
      [poster, head.posterBytes],
      [storyboard, head.storyboardBytes],
    ])) {
      if (size === 0) continue;
      if (path === null) throw corrupt("packed stream: a picture that the manifest does not name");
      add(path, size);
    }
    for (const language of names(manifest.captions, "language", MAX_CAPTIONS))
      add(`captions-${language}.vtt`, sizes.u32());
    /** Start of each segment's parts. @type {number[]} */
    this.starts = records.map((record) => {
      for (const name of sources) add(pathOf(record, SOUND_PREFIX + name), sizes.u32());
      const start = at;
      for (const part of this.parts) at += this.#headBytes(record, part) + record.objectBytes[part];
      return start;
    });
    sizes.finish();
    /** End of the objects. @type {number} */
    this.endByte = at;
  }

  /**
   * @param {import("../format/objects.js").SegmentRecord} record
   * @param {import("../format/manifest.js").Part} part @returns {Place}
   */
  object(record, part) {
    let at = this.starts[record.segment];
    for (const before of this.parts) {
      at += this.#headBytes(record, before);
      if (before === part) break;
      at += record.objectBytes[before];
    }
    return { first: at, size: record.objectBytes[part] };
  }

  /** @param {import("../format/objects.js").SegmentRecord} record @param {import("../format/manifest.js").Part} part */
  #headBytes(record, part) {
    return localBytes(pathOf(record, this.manifest.parts[part]));
  }
}

/** A stream in one file on any static host that supports ranges. */
export class PackedStream extends HostedStream {
  /**
   * @param {string} url @param {import("./fetcher.js").Fetcher} fetcher @param {PackedLayout} layout
   * @param {number | null} fileBytes null if the host hides it
   * @param {number} [bufferBytes] limit for the received data that is kept
   */
  constructor(url, fetcher, layout, fileBytes, bufferBytes) {
    super(url, fetcher, layout.manifest, false, bufferBytes);
    /** @type {PackedLayout} */ this.layout = layout;
    /** @type {number | null} */ this.fileBytes = fileBytes;
    this.index.records = layout.records;
  }

  /**
   * Reads the beginning of the file, with one or two requests. Rejects with a SourceError or a FormatError.
   * @override
   * @param {string} url @param {import("./fetcher.js").Fetcher} fetcher
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
   * @param {import("../format/objects.js").SegmentRecord} record
   * @param {import("../format/manifest.js").Part} part @param {(numBytes: number) => void} onBytes
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
