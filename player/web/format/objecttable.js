/** An object: a table, then the packets of one part of a segment (FORMAT.md, section 6). */

import {
  CODER,
  MAX_CHUNKS,
  MAX_OBJECT_BYTES,
  OBJECT_ENTRY,
  OBJECT_HEAD,
  SKIPPABLE_MAGIC,
  TABLE_MAGIC,
  VERSION,
  ZSTD_MAGIC,
} from "../constants.js";
import { ByteReader, isMagic } from "./bytes/bytereader.js";
import { corrupt, unsupported } from "./bytes/errors.js";

/** Bytes of the head after its size field, and of an entry. */
const [HEAD_BYTES, ENTRY_BYTES] = [12, 12];

/**
 * The packets of an object, by birth in order. Throws a FormatError.
 * @param {Uint8Array} bytes
 */
export function readObject(bytes) {
  if (bytes.length > MAX_OBJECT_BYTES)
    throw corrupt(`object: ${bytes.length} bytes, but at most ${MAX_OBJECT_BYTES} are allowed`);
  const reader = new ByteReader(bytes, "object");
  const [skippable, following, magic, version, coder, reserved, count] = reader.unpack(OBJECT_HEAD);
  if (skippable !== SKIPPABLE_MAGIC || !isMagic(magic, TABLE_MAGIC)) {
    throw corrupt("object: does not start with a table of chunks");
  }
  if (version !== VERSION) throw unsupported(`object: version ${version}, not ${VERSION}`);
  if (coder !== CODER) throw unsupported(`object: unknown coder ${coder}`);
  if (count > MAX_CHUNKS || reserved !== 0) {
    throw corrupt(`object: ${count} chunks or the reserved value ${reserved} is not valid`);
  }
  if (following !== HEAD_BYTES + ENTRY_BYTES * count) {
    throw corrupt(`object: a table of ${following} bytes for ${count} chunks`);
  }
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
    if (ZSTD_MAGIC.some((byte, i) => packet[i] !== byte))
      throw corrupt("object: a packet is not a zstd frame");
    packets.set(birth, packet);
    last = birth;
  }
  reader.finish();
  return packets;
}
