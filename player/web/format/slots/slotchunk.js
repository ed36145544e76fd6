/** The head of a chunk of version 2 (FORMAT.md, section 15). */

import { ByteReader } from "../bytes/bytereader.js";
import { corrupt, unsupported } from "../bytes/errors.js";

export const MASK = 0;
export const CHANGE = 1;
export const SNAPSHOT = 2;
const NAMES = ["mask", "change", "snapshot"];
const HAS_STARTS = 1;

/**
 * @typedef {object} SlotHead
 * @property {number} layer
 * @property {boolean} hasStarts
 * @property {number} birth
 * @property {ByteReader} body
 */

/**
 * The head of a chunk where one of this kind belongs.
 * @param {Uint8Array} bytes
 * @param {number} kind
 * @returns {SlotHead}
 */
export function readSlotHead(bytes, kind) {
  const name = NAMES[kind];
  const body = new ByteReader(bytes, name);
  if (body.magic() !== "SWG2") throw corrupt(`${name}: does not begin with SWG2`);
  const found = body.u8();
  const layer = body.u8();
  const flags = body.u8();
  const reserved = body.u8();
  const birth = body.i32();
  if (found >= NAMES.length) throw unsupported(`${name}: a chunk of unknown kind ${found}`);
  const known = found === MASK ? 0 : HAS_STARTS;
  if (reserved !== 0 || flags & ~known)
    throw unsupported(`${name}: unsupported flags ${flags} or reserved byte ${reserved}`);
  if (found !== kind) throw corrupt(`${name}: found a ${NAMES[found]} instead`);
  if (kind === MASK && layer !== 0) throw corrupt(`mask: has layer ${layer}, not 0`);
  return { layer, hasStarts: (flags & HAS_STARTS) !== 0, birth, body };
}

/**
 * Throws unless the chunk is the one that belongs here.
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
