/** An object: the packets of one part of a segment, behind a table (FORMAT.md, sections 7 and 18). */

import { ByteReader } from "./bytes/bytereader.js";
import { corrupt, unsupported } from "./bytes/errors.js";

const SKIPPABLE_MAGIC = 0x184d2a50;
const ENTRY_BYTES = 12;
const MAX_CHUNKS = 1 << 14;
const MAX_OBJECT_BYTES = 2 ** 30;
export const ZSTD = 1;
export const GZIP = 2;

/**
 * The packets of an object by birth, in order. Throws a FormatError.
 * @param {Uint8Array} bytes
 * @param {number} version of the stream
 * @returns {{ coder: number, packets: Map<number, Uint8Array> }}
 */
export function readObject(bytes, version) {
  if (bytes.length > MAX_OBJECT_BYTES)
    throw corrupt(`object: ${bytes.length} bytes, but at most ${MAX_OBJECT_BYTES} are allowed`);
  const reader = new ByteReader(bytes, "object");
  const skippable = reader.u32();
  const following = reader.u32();
  const magic = reader.magic();
  const found = reader.u8();
  const coder = reader.u8();
  const reserved = reader.u16();
  const count = reader.u32();
  if (skippable !== SKIPPABLE_MAGIC || magic !== "SWGO") {
    throw corrupt("object: does not start with a table of chunks");
  }
  if (found !== version)
    throw unsupported(`object: version ${found} in a stream of version ${version}`);
  if (coder !== ZSTD && coder !== GZIP) throw unsupported(`object: unknown coder ${coder}`);
  if (count > MAX_CHUNKS || (count === 0 && version === 1) || reserved !== 0) {
    throw corrupt(`object: ${count} chunks or the reserved value ${reserved} is not valid`);
  }
  if (following !== 12 + ENTRY_BYTES * count) {
    throw corrupt(`object: a table of ${following} bytes for ${count} chunks`);
  }
  const table = new ByteReader(reader.take(ENTRY_BYTES * count), "object");
  /** @type {Map<number, Uint8Array>} */
  const packets = new Map();
  let last = -Infinity;
  for (let i = 0; i < count; i++) {
    const birth = table.i32();
    const offset = table.u32();
    const size = table.u32();
    if (birth <= last) throw corrupt(`object: birth ${birth} after ${last}`);
    if (offset !== reader.at)
      throw corrupt(`object: a packet at byte ${offset}, but byte ${reader.at} is next`);
    if (size === 0) throw corrupt("object: a packet is empty");
    packets.set(birth, reader.take(size));
    last = birth;
  }
  reader.finish();
  return { coder, packets };
}
