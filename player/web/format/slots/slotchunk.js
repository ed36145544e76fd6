/** The head of a chunk (FORMAT.md, section 9). */

import { CHUNK_HEAD, CHUNK_KINDS, CHUNK_MAGIC, HAS_STARTS } from "../../constants.js";
import { ByteReader, isMagic } from "../bytes/bytereader.js";
import { corrupt, unsupported } from "../bytes/errors.js";

export const { MASK, CHANGE, SNAPSHOT } = CHUNK_KINDS;
const NAMES = Object.keys(CHUNK_KINDS).map((name) => name.toLowerCase());

/**
 * @typedef {object} SlotHead
 * @property {number} layer
 * @property {boolean} hasStarts
 * @property {number} birth
 * @property {ByteReader} body
 */

/**
 * Reads the head of a chunk that must have the given kind. Throws a FormatError.
 * @param {Uint8Array} bytes
 * @param {number} kind
 * @returns {SlotHead}
 */
export function readSlotHead(bytes, kind) {
  const name = NAMES[kind];
  const body = new ByteReader(bytes, name);
  const [magic, found, layer, flags, reserved, birth] = body.unpack(CHUNK_HEAD);
  if (!isMagic(magic, CHUNK_MAGIC)) throw corrupt(`${name}: does not begin with ${CHUNK_MAGIC}`);
  if (found >= NAMES.length) throw unsupported(`${name}: a chunk of unknown kind ${found}`);
  const known = found === MASK ? 0 : HAS_STARTS;
  if (reserved !== 0 || flags & ~known)
    throw unsupported(`${name}: unsupported flags ${flags} or reserved byte ${reserved}`);
  if (found !== kind) throw corrupt(`${name}: found a ${NAMES[found]} instead`);
  if (kind === MASK && layer !== 0) throw corrupt(`mask: has layer ${layer}, not 0`);
  return { layer, hasStarts: (flags & HAS_STARTS) !== 0, birth, body };
}

/**
 * Throws a FormatError unless the chunk has the expected birth and layer.
 * @param {SlotHead} head
 * @param {number} birth
 * @param {number} layer
 */
export function expectChunk(head, birth, layer) {
  if (head.birth !== birth || head.layer !== layer) {
    throw corrupt(
      `${head.body.what}: birth ${head.birth}, layer ${head.layer}; ` +
        `expected birth ${birth}, layer ${layer}`,
    );
  }
}
