/** index.bin, a record for each finished segment, and the objects it lists (FORMAT.md, sections 5 and 6). */

import {
  CODED,
  CODER,
  INDEX_CHECKSUM,
  INDEX_HEAD,
  INDEX_LAYER,
  INDEX_SIDE,
  MAX_CHUNKS,
  MAX_OBJECT_BYTES,
  OBJECT_ENTRY,
  OBJECT_HEAD,
  SKIPPABLE_MAGIC,
  TABLE_MAGIC,
  VERSION,
  ZSTD_MAGIC,
} from "../constants.js";
import { ByteReader, corrupt, isMagic, unsupported } from "./bytes.js";

const TABLE = new Uint32Array(256).map((_, n) => {
  let c = n;
  for (let bit = 0; bit < 8; bit++) c = c & 1 ? (c >>> 1) ^ 0xedb88320 : c >>> 1;
  return c;
});

/** The CRC-32 of zlib and PNG. @param {Uint8Array} bytes */
export function crc32(bytes) {
  let c = 0xffffffff;
  for (const byte of bytes) c = TABLE[(c ^ byte) & 255] ^ (c >>> 8);
  return (c ^ 0xffffffff) >>> 0;
}

/**
 * @typedef {object} SegmentRecord
 * @property {number} segment @property {number} firstFrame @property {number} numFrames
 * @property {number[]} psnrDb of layers 0 .. n together; NaN where unknown
 * @property {number[]} objectBytes of each part, in the order of `Manifest.parts`
 * @property {Uint8Array[]} objectSha256 of each part, in the same order
 */

/** Size of a record. @param {import("./manifest.js").Manifest} manifest */
export function recordBytes(manifest) {
  return 60 + 84 * manifest.numLayers;
}

/**
 * Reads the complete records in `bytes`, beginning with that of `firstSegment`. A last record that is cut
 * short or all zeros is omitted. Throws a FormatError.
 * @param {Uint8Array} bytes @param {import("./manifest.js").Manifest} manifest @param {number} [firstSegment]
 * @returns {SegmentRecord[]}
 */
export function readIndex(bytes, manifest, firstSegment = 0) {
  const size = recordBytes(manifest);
  const rows = /** @type {Uint8Array[]} */ ([]);
  for (let at = 0; at + size <= bytes.length; at += size) rows.push(bytes.subarray(at, at + size));
  if (rows.length > 0 && rows[rows.length - 1].every((byte) => byte === 0)) rows.pop();
  return rows.map((row, n) => {
    const record = readRecord(row, firstSegment + n, manifest);
    if (n < rows.length - 1 && record.numFrames !== manifest.segmentFrames)
      throw corrupt(`index: segment ${record.segment} is short, but not the last`);
    return record;
  });
}

/**
 * @param {Uint8Array} row @param {number} segment @param {import("./manifest.js").Manifest} manifest
 * @returns {SegmentRecord}
 */
function readRecord(row, segment, manifest) {
  const what = `index: the record of segment ${segment}`;
  const reader = new ByteReader(row, what);
  const [found, firstFrame, numFrames, reserved] = reader.unpack(INDEX_HEAD);
  const psnrDb = /** @type {number[]} */ ([]);
  const objectBytes = /** @type {number[]} */ ([]);
  const objectSha256 = /** @type {Uint8Array[]} */ ([]);
  for (let part = 0; part < manifest.parts.length; part++) {
    const isLayer = part < manifest.numLayers;
    const [size, sha256, psnr = NaN] = /** @type {[number, Uint8Array, number?]} */ (
      reader.unpack(isLayer ? INDEX_LAYER : INDEX_SIDE)
    );
    objectBytes.push(size);
    objectSha256.push(sha256);
    if (isLayer) psnrDb.push(psnr);
  }
  const covered = row.subarray(0, reader.at);
  const [checksum] = reader.unpack(INDEX_CHECKSUM);
  if (checksum !== crc32(covered)) throw corrupt(`${what} has a wrong checksum`);
  const { segmentFrames } = manifest;
  if (found !== segment || firstFrame !== segment * segmentFrames || reserved !== 0)
    throw corrupt(`${what} describes ${found}, from frame ${firstFrame} on`);
  if (numFrames < 1 || numFrames > segmentFrames) throw corrupt(`${what} has ${numFrames} frames`);
  if (psnrDb.some((psnr) => Math.abs(psnr) === Infinity))
    throw corrupt(`${what} has an infinite PSNR`);
  if (objectBytes.some((size) => size > MAX_OBJECT_BYTES))
    throw corrupt(`${what} names an object that is too large`);
  return { segment, firstFrame, numFrames, psnrDb, objectBytes, objectSha256 };
}

/** Bytes of the head after its size field, and of an entry. */
const [HEAD_BYTES, ENTRY_BYTES] = [12, 12];

/** The packets of an object, by birth in order. Throws a FormatError. @param {Uint8Array} bytes */
export function readObject(bytes) {
  if (bytes.length > MAX_OBJECT_BYTES)
    throw corrupt(`object: ${bytes.length} bytes, but at most ${MAX_OBJECT_BYTES} are allowed`);
  const reader = new ByteReader(bytes, "object");
  const [skippable, following, magic, version, coder, reserved, count] = reader.unpack(OBJECT_HEAD);
  if (skippable !== SKIPPABLE_MAGIC || !isMagic(magic, TABLE_MAGIC))
    throw corrupt("object: does not start with a table of chunks");
  if (version !== VERSION) throw unsupported(`object: version ${version}, not ${VERSION}`);
  if (coder !== CODER) throw unsupported(`object: coder ${coder}, not ${CODER}`);
  if (count > MAX_CHUNKS || reserved !== 0)
    throw corrupt(`object: ${count} chunks or the reserved value ${reserved} is not valid`);
  if (following !== HEAD_BYTES + ENTRY_BYTES * count)
    throw corrupt(`object: a table of ${following} bytes for ${count} chunks`);
  const table = new ByteReader(reader.take(ENTRY_BYTES * count), "object");
  /** @type {Map<number, Uint8Array>} */
  const packets = new Map();
  let last = -Infinity;
  for (let i = 0; i < count; i++) {
    const [birth, offset, size] = table.unpack(OBJECT_ENTRY);
    if (birth <= last) throw corrupt(`object: birth ${birth} after ${last}`);
    if (offset !== reader.at)
      throw corrupt(`object: a packet at byte ${offset}, but byte ${reader.at} is next`);
    if (size === 0) throw corrupt("object: a packet is empty");
    const packet = reader.take(size);
    if (packet[0] !== CODED && ZSTD_MAGIC.some((byte, i) => packet[i] !== byte))
      throw corrupt("object: a packet is not a zstd frame");
    packets.set(birth, packet);
    last = birth;
  }
  reader.finish();
  return packets;
}
