/**
 * The new data of a slice, a change, and all slots at a segment's first frame, a keyframe (FORMAT.md,
 * sections 10 and 11).
 */

import {
  CHANGE_COUNTS,
  COUNTS_BYTES,
  EMPTY,
  LONG,
  MAX_GAP_BITS,
  NEW,
  POSITION_LIMIT,
} from "../../constants.js";
import { BitReader, ByteReader, corrupt } from "../bytes.js";
import { checkGaussians, readGaussians } from "../gaussians.js";
import { CHANGE, expectChunk, readSlotHead, KEYFRAME } from "./skipmap.js";
import { Slots } from "./slots.js";

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
  if (numLong > 3 * predicted || numEscapes > added) {
    throw corrupt(`${what}: ${numLong} long residuals and ${numEscapes} escapes are too many`);
  }
  const { numAttributes, k } = layout;
  const numPlanes = 3 + numAttributes;
  const expected =
    numPlanes * predicted +
    4 * numLong +
    numPlanes * added +
    lowBitBytes +
    4 * (1 + 11 + 3 * k) * numEscapes +
    (hasStarts ? added : 0);
  if (body.left !== expected) {
    throw corrupt(`${what}: ${body.left} bytes follow the counts, but the counts say ${expected}`);
  }
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
    if (escapes[i] >= added || (i > 0 && escapes[i] <= escapes[i - 1])) {
      throw corrupt(`${what}: its escapes do not increase, or are not below ${added}`);
    }
  }
  const floats = readGaussians(body, numEscapes, k);
  checkGaussians(floats, what);
  const startOffsets = hasStarts ? body.take(added).slice() : new Uint8Array(added);
  if (startOffsets.some((offset) => offset >= layout.swinSize)) {
    throw corrupt(`${what}: a start offset is not below ${layout.swinSize}`);
  }
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
  if (used !== long.length) {
    throw corrupt(`${what}: ${used} residuals are long, but its count says ${long.length}`);
  }
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
  if (frame < 0 || frame !== layout.segmentStart(frame)) {
    throw corrupt(`keyframe: frame ${frame} is not the first frame of a segment`);
  }
  const count = layout.slots[layer];
  const numFlags = layout.swinSize * count;
  const flags = body.take(Math.ceil(numFlags / 8));
  if (numFlags % 8 !== 0 && flags[flags.length - 1] >> numFlags % 8 !== 0) {
    throw corrupt("keyframe: a bit is set after the last flag");
  }
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
  for (const [row, values] of all.escapes) {
    lanes[Math.floor(row / count)].escapes.set(row % count, values);
  }
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
