/** A packed stream: one file with all files of a stream, at places that follow from its beginning. */

import {
  MAX_INDEX_BYTES,
  MAX_MANIFEST_BYTES,
  MAX_PICTURE_BYTES,
  PACKED_EXTRA,
  PACKED_EXTRA_ID,
  PACKED_VERSION,
  ZIP_LOCAL,
  ZIP_LOCAL_MAGIC,
} from "../constants.js";
import { ByteReader, isMagic } from "./bytes/bytereader.js";
import { corrupt, unsupported } from "./bytes/errors.js";

const MANIFEST_NAME = "manifest.json";
const INDEX_NAME = "index.bin";
/** Bytes of a local header without the name, and of the extra field of the first one. */
const [LOCAL_BYTES, EXTRA_BYTES] = [30, 20];

/** Where the manifest begins. */
const MANIFEST_AT = localBytes(MANIFEST_NAME) + EXTRA_BYTES;

/**
 * A run of bytes of the file.
 * @typedef {object} Place
 * @property {number} first
 * @property {number} size
 */

/**
 * The sizes that only the beginning of the file says.
 * @typedef {object} PackedHead
 * @property {Place} manifest
 * @property {Place} index
 * @property {number} posterBytes 0 for none
 * @property {number} storyboardBytes 0 for none, and for one that is the poster as well
 */

/** The size of the local header of a file. @param {string} name */
function localBytes(name) {
  return LOCAL_BYTES + new TextEncoder().encode(name).length;
}

/**
 * What stands at the beginning of a packed stream. Throws a FormatError.
 * @param {Uint8Array} bytes the first ones of it
 * @returns {PackedHead}
 */
export function readPackedHead(bytes) {
  const reader = new ByteReader(bytes, "packed stream");
  const local = reader.unpack(ZIP_LOCAL);
  const [magic] = local;
  const [storedBytes, manifestBytes, nameBytes, extraBytes] = local.slice(-4);
  const name = reader.take(MANIFEST_NAME.length);
  const [id, following, version, reserved, indexBytes, posterBytes, storyboardBytes] =
    reader.unpack(PACKED_EXTRA);
  const isPacked =
    magic === ZIP_LOCAL_MAGIC &&
    nameBytes === MANIFEST_NAME.length &&
    isMagic(name, MANIFEST_NAME) &&
    extraBytes === EXTRA_BYTES &&
    id === PACKED_EXTRA_ID &&
    following === EXTRA_BYTES - 4;
  if (!isPacked) throw corrupt("packed stream: does not begin as one; make it with swings-stream");
  if (version !== PACKED_VERSION || reserved !== 0)
    throw unsupported(`packed stream: unknown layout ${version}`);
  if (manifestBytes !== storedBytes || !(manifestBytes > 0 && manifestBytes <= MAX_MANIFEST_BYTES))
    throw corrupt(`packed stream: a manifest of ${manifestBytes} bytes`);
  if (!(indexBytes > 0 && indexBytes <= MAX_INDEX_BYTES))
    throw corrupt(`packed stream: an index of ${indexBytes} bytes`);
  if (Math.max(posterBytes, storyboardBytes) > MAX_PICTURE_BYTES)
    throw corrupt("packed stream: too large a picture");
  const indexAt = MANIFEST_AT + manifestBytes + localBytes(INDEX_NAME);
  return {
    manifest: { first: MANIFEST_AT, size: manifestBytes },
    index: { first: indexAt, size: indexBytes },
    posterBytes,
    storyboardBytes,
  };
}

/** Where everything else lies. */
export class PackedLayout {
  /**
   * @param {PackedHead} head
   * @param {import("./manifest.js").Manifest} manifest
   * @param {import("./streamindex.js").SegmentRecord[]} records
   */
  constructor(head, manifest, records) {
    this.manifest = manifest;
    this.records = records;
    const layers = Array.from({ length: manifest.numLayers }, (_, layer) => layer);
    /** As they lie in a segment: a player of n layers needs what is side by side. */
    this.parts = [
      ...layers.map((layer) => `snapshot-${layer}`).reverse(),
      "masks",
      ...layers.map(String),
    ];
    let at = head.index.first + head.index.size;
    /** @type {Record<string, Place>} by path */
    this.pictures = {};
    const { poster } = manifest;
    const storyboard = manifest.storyboard === poster ? null : manifest.storyboard;
    for (const [path, size] of /** @type {[string | null, number][]} */ ([
      [poster, head.posterBytes],
      [storyboard, head.storyboardBytes],
    ])) {
      if (size === 0) continue;
      if (path === null) throw corrupt("packed stream: a picture that the manifest does not name");
      at += localBytes(path);
      this.pictures[path] = { first: at, size };
      at += size;
    }
    /** Where each segment begins. */
    this.starts = records.map((record) => {
      const start = at;
      for (const part of this.parts)
        at += this.#headerBytes(record, part) + this.#size(record, part);
      return start;
    });
    /** Where the objects end. */
    this.endByte = at;
  }

  /**
   * @param {import("./streamindex.js").SegmentRecord} record
   * @param {string} part
   * @returns {Place}
   */
  object(record, part) {
    let at = this.starts[record.segment];
    for (const before of this.parts) {
      at += this.#headerBytes(record, before);
      if (before === part) break;
      at += this.#size(record, before);
    }
    return { first: at, size: this.#size(record, part) };
  }

  /** @param {import("./streamindex.js").SegmentRecord} record @param {string} part */
  #headerBytes({ segment }, part) {
    return LOCAL_BYTES + `segments/${segment}/${part}`.length;
  }

  /** @param {import("./streamindex.js").SegmentRecord} record @param {string} part */
  #size({ objectBytes }, part) {
    return objectBytes[this.manifest.parts.indexOf(part)];
  }
}
