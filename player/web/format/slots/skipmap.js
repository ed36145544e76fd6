/**
 * The head of a chunk, and the skip map of a slice: the status of each slot of its lane (FORMAT.md, section 9).
 */

import {
  CHUNK_HEAD,
  CHUNK_KINDS,
  CHUNK_MAGIC,
  CONTEXT_OF_C,
  CONTEXTS,
  ENDED,
  FIRST_OF_B,
  FIRST_PROBABILITY,
  HAS_STARTS,
  KEPT,
  LEAST_RANGE,
  MOST_COUNTED,
  NEW,
  PREDICTED,
  WHOLE_RANGE,
} from "../../constants.js";
import { ByteReader, corrupt, isMagic, unsupported } from "../bytes.js";

const { SKIP_MAP } = CHUNK_KINDS;
export const { CHANGE, KEYFRAME } = CHUNK_KINDS;
const NAMES = Object.keys(CHUNK_KINDS).map((name) => name.toLowerCase().replace("_", " "));

/**
 * @typedef {object} SlotHead
 * @property {number} layer @property {boolean} hasStarts @property {number} birth @property {ByteReader} body
 */

/**
 * Reads the head of a chunk that must have the given kind. Throws a FormatError.
 * @param {Uint8Array} bytes @param {number} kind @returns {SlotHead}
 */
export function readSlotHead(bytes, kind) {
  const name = NAMES[kind];
  const body = new ByteReader(bytes, name);
  const [magic, found, layer, flags, reserved, birth] = body.unpack(CHUNK_HEAD);
  if (!isMagic(magic, CHUNK_MAGIC)) throw corrupt(`${name}: does not begin with ${CHUNK_MAGIC}`);
  if (found >= NAMES.length) throw unsupported(`${name}: a chunk of unknown kind ${found}`);
  const known = found === SKIP_MAP ? 0 : HAS_STARTS;
  if (reserved !== 0 || flags & ~known)
    throw unsupported(`${name}: unsupported flags ${flags} or reserved byte ${reserved}`);
  if (found !== kind) throw corrupt(`${name}: found a ${NAMES[found]} instead`);
  if (kind === SKIP_MAP && layer !== 0) throw corrupt(`skip map: has layer ${layer}, not 0`);
  return { layer, hasStarts: (flags & HAS_STARTS) !== 0, birth, body };
}

/**
 * Throws a FormatError unless the chunk has the expected birth and layer.
 * @param {SlotHead} head @param {number} birth @param {number} layer
 */
export function expectChunk(head, birth, layer) {
  if (head.birth !== birth || head.layer !== layer) {
    throw corrupt(
      `${head.body.what}: birth ${head.birth}, layer ${head.layer}; ` +
        `expected birth ${birth}, layer ${layer}`,
    );
  }
}

/** An adaptive binary arithmetic decoder. */
class BitDecoder {
  at = 0;
  range = WHOLE_RANGE;
  code = 0;
  p = new Uint16Array(CONTEXTS).fill(FIRST_PROBABILITY);
  c = new Uint8Array(CONTEXTS);

  /** @param {Uint8Array} body */
  constructor(body) {
    this.body = body;
    for (let i = 0; i < 4; i++) this.code = this.code * 256 + this.#next();
    if (this.code === WHOLE_RANGE) throw corrupt("skip map: its code is not below its range");
  }

  #next() {
    if (this.at >= this.body.length)
      throw corrupt(`skip map: a body of ${this.body.length} bytes is too short`);
    return this.body[this.at++];
  }

  /** @param {number} context */
  bit(context) {
    const p = this.p[context];
    const bound = (this.range >>> 12) * (p >> 4);
    const bit = this.code < bound ? 0 : 1;
    if (bit) {
      this.code -= bound;
      this.range -= bound;
    } else {
      this.range = bound;
    }
    while (this.range < LEAST_RANGE) {
      this.range *= 256;
      this.code = this.code * 256 + this.#next();
    }
    const count = Math.min(this.c[context] + 1, MOST_COUNTED);
    const shift = 31 - Math.clz32(count + 1);
    this.c[context] = count;
    this.p[context] = bit ? p - (p >> shift) : p + ((65535 - p) >> shift);
    return bit;
  }
}

/**
 * Decodes the skip map of the slice born at `birth`: the statuses of all layers (numSlots). With an empty skip map,
 * all slots are kept. Throws a FormatError.
 * @param {import("../gaussians.js").SlotLayout} layout @param {number} birth @param {Uint8Array} bytes
 * @param {Uint8Array} history (numSlots) from `SkipMapHistory.of(birth)`
 */
export function decodeSkipMap(layout, birth, bytes, history) {
  const statuses = new Uint8Array(layout.numSlots);
  if (bytes.length === 0) return statuses;
  const head = readSlotHead(bytes, SKIP_MAP);
  expectChunk(head, birth, 0);
  const body = head.body.take(head.body.left);
  const decoder = new BitDecoder(body);
  let i = 0;
  for (const count of layout.slots) {
    let before = 0; // bit 0: the previous slot is not kept; bits 1 and 2: the two slots before it
    for (const end = i + count; i < end; i++) {
      const h = history[i];
      const near = ((before & 1) << 1) | ((before >> 1) & 1);
      let changed = 1;
      if (decoder.bit(8 * h + 2 * near + (before >> 2)) === 0) changed = 0;
      else if (decoder.bit(FIRST_OF_B + h) === 0) statuses[i] = PREDICTED;
      else statuses[i] = decoder.bit(CONTEXT_OF_C) === 0 ? NEW : ENDED;
      before = ((before << 1) | changed) & 7;
    }
  }
  if (decoder.at !== body.length)
    throw corrupt(`skip map: ${body.length - decoder.at} bytes too long`);
  return statuses;
}

/** Records which slots earlier skip maps of a segment did not keep; these are contexts of later skip maps. */
export class SkipMapHistory {
  /** @param {import("../gaussians.js").SlotLayout} layout */
  constructor(layout) {
    this.layout = layout;
    /** 2 if not kept by the lane's last skip map, plus 1 if not kept by the skip map before it. */
    this.recent = Array.from({ length: layout.swinSize }, () => new Uint8Array(layout.numSlots));
    /** @type {boolean[]} for each lane, whether one of its skip maps was missing */
    this.lost = new Array(layout.swinSize).fill(false);
  }

  /** The `h` of each slot in the skip map of `birth`. @param {number} birth */
  of(birth) {
    if (birth === this.layout.segmentStart(birth)) return new Uint8Array(this.layout.numSlots);
    return this.recent[this.layout.lane(birth)];
  }

  /** Whether all earlier skip maps that the skip map of `birth` depends on are known. @param {number} birth */
  isReadable(birth) {
    return birth === this.layout.segmentStart(birth) || !this.lost[this.layout.lane(birth)];
  }

  /**
   * Records the skip map of `birth`. The skip map of a segment's first frame resets the history.
   * @param {number} birth @param {Uint8Array | null} statuses null if it is missing
   */
  note(birth, statuses) {
    if (birth === this.layout.segmentStart(birth)) {
      for (const lane of this.recent) lane.fill(0);
      this.lost.fill(false);
      return;
    }
    const lane = this.layout.lane(birth);
    if (statuses === null) {
      this.lost[lane] = true;
      return;
    }
    const recent = this.recent[lane];
    for (let i = 0; i < recent.length; i++) {
      recent[i] = (recent[i] >> 1) | (statuses[i] === KEPT ? 0 : 2);
    }
  }
}
