/**
 * The chunks of a slice: its skip map, the status of each slot of its lane; its new data, a change for each layer; and
 * all slots at a segment's first frame, a keyframe (FORMAT.md, sections 9 to 11).
 */

import {
  CHANGE_COUNTS,
  CHUNK_HEAD,
  CHUNK_KINDS,
  CHUNK_MAGIC,
  CONTEXT_OF_C,
  CONTEXTS,
  COUNTS_BYTES,
  EMPTY,
  ENDED,
  FIRST_OF_B,
  FIRST_PROBABILITY,
  HAS_STARTS,
  KEPT,
  LEAST_RANGE,
  LONG,
  MAX_GAP_BITS,
  MOST_COUNTED,
  NEW,
  POSITION_LIMIT,
  PREDICTED,
  WHOLE_RANGE,
} from "../../constants.js";
import { BitReader, ByteReader, corrupt, isMagic, unsupported } from "../bytes.js";
import { checkGaussians, readGaussians } from "../gaussians.js";
import { Slots } from "./slots.js";

const { CHANGE, KEYFRAME, SKIP_MAP } = CHUNK_KINDS;
const NAMES = Object.keys(CHUNK_KINDS).map((name) => name.toLowerCase().replace("_", " "));

/**
 * @typedef {object} SlotHead
 * @property {number} layer @property {boolean} hasStarts @property {number} birth @property {ByteReader} body
 */

/**
 * Reads the head of a chunk that must have the given kind. Throws a FormatError.
 * @param {Uint8Array} bytes @param {number} kind @returns {SlotHead}
 */
function readSlotHead(bytes, kind) {
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
function expectChunk(head, birth, layer) {
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
    /** @type {Uint8Array} */ this.body = body;
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
    /** 2 if not kept by the lane's last skip map, plus 1 if not kept by the skip map before it. @type {Uint8Array[]} */
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
    for (let i = 0; i < recent.length; i++)
      recent[i] = (recent[i] >> 1) | (statuses[i] === KEPT ? 0 : 2);
  }
}

/**
 * @typedef {object} Change
 * @property {Int32Array} moves (P, 3) differences of positions, in steps
 * @property {Uint8Array} turns (P, A) differences of attributes, modulo 256
 * @property {Int32Array} positions (N, 3) of new Gaussians, in steps
 * @property {Uint8Array} attributes (N, A) of new Gaussians; two's complement, the opacity unsigned
 * @property {Uint8Array} startOffsets (N) frames after the birth
 * @property {Uint32Array} escapes (E) indices of the new Gaussians that are not on the lattice
 * @property {import("../gaussians.js").Gaussians} floats (E) those Gaussians
 */

/**
 * Decodes a change. Throws a FormatError.
 * @param {import("../gaussians.js").SlotLayout} layout @param {number} layer @param {number} birth
 * @param {Uint8Array} bytes empty if nothing changes @param {number} numPredicted as counted in the skip map
 * @param {number} numNew as counted in the skip map @returns {Change}
 */
export function decodeChange(layout, layer, birth, bytes, numPredicted, numNew) {
  if (bytes.length === 0) {
    if (numPredicted || numNew) {
      throw corrupt(
        `change: it is missing, but the skip map says ${numPredicted} predicted and ${numNew} new`,
      );
    }
    const nothing = new ByteReader(new Uint8Array(COUNTS_BYTES), "change");
    return readChange(layout, layer, nothing, 0, 0, false);
  }
  const head = readSlotHead(bytes, CHANGE);
  expectChunk(head, birth, layer);
  return readChange(layout, layer, head.body, numPredicted, numNew, head.hasStarts);
}

/**
 * Reads the change that fills the rest of `body`.
 * @param {import("../gaussians.js").SlotLayout} layout @param {number} layer @param {ByteReader} body
 * @param {number} numPredicted @param {number} numNew @param {boolean} hasStarts @returns {Change}
 */
function readChange(layout, layer, body, numPredicted, numNew, hasStarts) {
  const what = body.what;
  const [predicted, added, numLong, numEscapes, lowBitBytes] = body.unpack(CHANGE_COUNTS);
  if (predicted !== numPredicted || added !== numNew) {
    throw corrupt(
      `${what}: ${predicted} predicted and ${added} new, expected ${numPredicted} and ${numNew}`,
    );
  }
  if (numLong > 3 * predicted || numEscapes > added)
    throw corrupt(`${what}: ${numLong} long residuals and ${numEscapes} escapes are too many`);
  const { numAttributes, k } = layout;
  const numPlanes = 3 + numAttributes;
  const expected =
    numPlanes * predicted +
    4 * numLong +
    numPlanes * added +
    lowBitBytes +
    4 * (1 + 11 + 3 * k) * numEscapes +
    (hasStarts ? added : 0);
  if (body.left !== expected)
    throw corrupt(`${what}: ${body.left} bytes follow the counts, but the counts say ${expected}`);
  const places = body.take(3 * predicted);
  const turns = body.take(numAttributes * predicted);
  const moves = readMoves(places, body.i32s(numLong), what);
  const lengths = body.take(3 * added);
  const planes = body.take(numAttributes * added);
  const positions = readPositions(lengths, body.take(lowBitBytes), what);
  const levels = layout.lattices[layer].opacityLevels;
  const attributes = readAttributes(planes, added, numAttributes, levels, what);
  const escapes = body.u32s(numEscapes);
  for (let i = 0; i < numEscapes; i++) {
    if (escapes[i] >= added || (i > 0 && escapes[i] <= escapes[i - 1]))
      throw corrupt(`${what}: its escapes do not increase, or are not below ${added}`);
  }
  const floats = readGaussians(body, numEscapes, k);
  checkGaussians(floats, what);
  const startOffsets = hasStarts ? body.take(added).slice() : new Uint8Array(added);
  if (startOffsets.some((offset) => offset >= layout.swinSize))
    throw corrupt(`${what}: a start offset is not below ${layout.swinSize}`);
  return {
    moves,
    turns: readTurns(turns, predicted, numAttributes),
    positions,
    attributes,
    startOffsets,
    escapes,
    floats,
  };
}

/** @param {number} z */
function unzigzag(z) {
  return (z >>> 1) ^ -(z & 1);
}

/** @param {Uint8Array} planes (3, P) @param {Int32Array} long @param {string} what */
function readMoves(planes, long, what) {
  const count = planes.length / 3;
  const moves = new Int32Array(planes.length);
  let used = 0;
  for (let axis = 0, at = 0; axis < 3; axis++) {
    for (let i = 0; i < count; i++, at++) {
      const z = planes[at];
      moves[3 * i + axis] = z === LONG ? long[used++] : unzigzag(z);
    }
  }
  if (used !== long.length)
    throw corrupt(`${what}: ${used} residuals are long, but its count says ${long.length}`);
  return moves;
}

/** @param {Uint8Array} planes (A, P) @param {number} count @param {number} numAttributes */
function readTurns(planes, count, numAttributes) {
  const turns = new Uint8Array(planes.length);
  for (let plane = 0, at = 0; plane < numAttributes; plane++) {
    for (let i = 0; i < count; i++, at++) turns[numAttributes * i + plane] = unzigzag(planes[at]);
  }
  return turns;
}

/** @param {Uint8Array} lengths (3, N) @param {Uint8Array} lowBits @param {string} what */
function readPositions(lengths, lowBits, what) {
  let numBits = 0;
  for (const g of lengths) {
    if (g > MAX_GAP_BITS) throw corrupt(`${what}: a gap of ${g} bits`);
    if (g > 1) numBits += g - 1;
  }
  const bits = new BitReader(lowBits, numBits, what);
  const count = lengths.length / 3;
  const positions = new Int32Array(lengths.length);
  const place = [0, 0, 0];
  for (let i = 0; i < count; i++) {
    for (let axis = 0; axis < 3; axis++) {
      const g = lengths[axis * count + i];
      if (g > 0) place[axis] += unzigzag((1 << (g - 1)) | bits.take(g - 1));
      if (Math.abs(place[axis]) >= POSITION_LIMIT)
        throw corrupt(`${what}: a position is outside the lattice`);
      positions[3 * i + axis] = place[axis];
    }
  }
  return positions;
}

/**
 * @param {Uint8Array} planes (A, N) @param {number} count @param {number} numAttributes
 * @param {number} levels @param {string} what
 */
function readAttributes(planes, count, numAttributes, levels, what) {
  const attributes = new Uint8Array(planes.length);
  const last = numAttributes - 1;
  for (let plane = 0, at = 0; plane < last; plane++) {
    for (let i = 0; i < count; i++, at++) attributes[numAttributes * i + plane] = planes[at] ^ 128;
  }
  for (let i = 0, at = last * count; i < count; i++, at++) {
    if (planes[at] >= levels) throw corrupt(`${what}: opacity ${planes[at]} of ${levels} levels`);
    attributes[numAttributes * i + last] = planes[at];
  }
  return attributes;
}

/**
 * @typedef {object} Keyframe
 * @property {number} frame @property {number} layer
 * @property {Slots[]} lanes the lanes of births frame - swinSize + 1 .. frame
 */

/**
 * Decodes a keyframe, of any layer and segment. Throws a FormatError.
 * @param {import("../gaussians.js").SlotLayout} layout @param {Uint8Array} bytes @returns {Keyframe}
 */
export function decodeKeyframe(layout, bytes) {
  const { layer, birth: frame, hasStarts, body } = readSlotHead(bytes, KEYFRAME);
  if (layer >= layout.numLayers)
    throw corrupt(`keyframe: layer ${layer}, but the stream has ${layout.numLayers} layers`);
  if (frame < 0 || frame !== layout.segmentStart(frame))
    throw corrupt(`keyframe: frame ${frame} is not the first frame of a segment`);
  const count = layout.slots[layer];
  const numFlags = layout.swinSize * count;
  const flags = body.take(Math.ceil(numFlags / 8));
  if (numFlags % 8 !== 0 && flags[flags.length - 1] >> numFlags % 8 !== 0)
    throw corrupt("keyframe: a bit is set after the last flag");
  const statuses = new Uint8Array(numFlags);
  let numNew = 0;
  for (let i = 0; i < numFlags; i++) {
    if ((flags[i >> 3] >> (i & 7)) & 1) {
      statuses[i] = NEW;
      numNew++;
    }
  }
  const change = readChange(layout, layer, body, 0, numNew, hasStarts);
  // All lanes are decoded as if they were one, and then separated.
  const all = new Slots(numFlags, layout.numAttributes, EMPTY);
  all.advance(all.delta(statuses, change, layout.lattices[layer].opacityLevels));
  const lanes = [...Array(layout.swinSize).keys()].map((lane) => part(all, lane, count));
  for (const [row, values] of all.escapes)
    lanes[Math.floor(row / count)].escapes.set(row % count, values);
  return { frame, layer, lanes };
}

/**
 * The slots of one lane, without the escaped Gaussians.
 * @param {Slots} all @param {number} lane @param {number} count of a lane
 */
function part(all, lane, count) {
  const first = lane * count;
  const end = first + count;
  const width = all.numAttributes;
  const made = new Slots(0, width, EMPTY);
  made.count = count;
  made.conditions = all.conditions.slice(first, end);
  made.positions = all.positions.slice(3 * first, 3 * end);
  made.attributes = all.attributes.slice(width * first, width * end);
  made.starts = all.starts.slice(first, end);
  return made;
}
