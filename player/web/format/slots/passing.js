/**
 * Passing slices: they change what one frame shows, but not the slots (FORMAT.md, 2.1 and 10.5).
 * This module is loaded only for streams with a temporal layer, which are few.
 */

import { ENDED, NEW, ON_LATTICE, PREDICTED } from "../../constants.js";
import { FormatError, corrupt } from "../bytes/errors.js";
import { decodeChange } from "./change.js";
import { MaskHistory, decodeMask } from "./mask.js";
import { jumps, moveOf } from "./moves.js";
import { PASSING, expectChunk, readSlotHead } from "./slotchunk.js";
import { SlotDecoder } from "./slotdecoder.js";
import { changedRows, signed } from "./slots.js";

/** @typedef {import("./slots.js").Slots} Slots */
// Types that the class below inherits, imported because the npm package's declarations name them.
/** @typedef {import("./slotdecoder.js").SlotSlice} SlotSlice */
/** @typedef {import("./slotdecoder.js").Log} Log */
/** @typedef {import("./slotdecoder.js").Said} Said */

/**
 * A passing slice, and the slots that its frame shows.
 * @typedef {object} Passing
 * @property {number} birth
 * @property {Uint8Array[]} parts the statuses of each layer
 * @property {(Uint8Array | null)[]} changes of each layer that has slots
 * @property {Next | null} next if the slice is interpolated for a missing one: the slice it leads to
 * @property {Slots[]} slots
 */

/**
 * The slice after a missing passing slice; `Passing.changes` are then those of this slice.
 * @typedef {object} Next
 * @property {number} birth
 * @property {Uint8Array[]} parts the statuses of each layer
 * @property {number} share of the motion to it that is over
 */

/** The decoder for streams with a temporal layer. */
export class PassingDecoder extends SlotDecoder {
  /** @type {Passing | null} the last slice, if it is a passing one */
  passing = null;
  /** @type {Uint8Array | null} mask history for the last passing slice, if that is missing */
  #historyOfMissing = null;

  /**
   * @override
   * @param {number} birth
   * @param {Uint8Array | null} mask
   * @param {(Uint8Array | null)[]} changes
   * @param {import("./slotdecoder.js").Ahead} [ahead]
   */
  apply(birth, mask, changes, ahead) {
    const { layout } = this;
    const last = layout.numLayers - 1;
    const passes = birth % layout.period > 0;
    const chunk = changes[last] ?? null;
    const history = this.history.isReadable(birth) ? this.history.of(birth) : null;
    let passing = null;
    if (history !== null) {
      if (passes && mask?.length && decodeMask(layout, birth, mask, history).some(Boolean))
        throw corrupt("mask: a passing slice does not keep all slots");
      if (chunk !== null) passing = decodePassing(this, birth, chunk, history);
      else if (passes) passing = interpolated(this, birth, ahead);
    }
    const isMissing = passes && chunk === null;
    const historyOfMissing = isMissing && history !== null ? history.slice() : null;
    const before = this.passing;
    const from = before?.slots ?? [...this.lanes[0]];
    const slice = super.apply(birth, passes ? none : mask, changes.slice(0, last), ahead);
    this.passing = passing;
    this.#historyOfMissing = historyOfMissing;
    if (passes) this.numMissing = isMissing ? 1 : 0;
    const { moves } = slice;
    const said = this.statuses && byLayer(this, this.statuses);
    const rows = slice.rows.map((own, layer) => {
      const parts = [passing, before].flatMap((one) => one?.parts[layer] ?? []);
      if (!parts.some((part) => part.some(Boolean))) return own;
      const all = joined(own, parts);
      // Slots altered by late bytes do not move, nor do slots that a passing slice no longer fits.
      const isKnown = moves?.[layer].length === own.length;
      if (moves === undefined || !isKnown) return all;
      const slots = passing?.slots[layer] ?? this.lanes[0][layer];
      if (from[layer] === slots) moves[layer] = new Uint8Array();
      else {
        if (said !== null) parts.push(said[layer]);
        moves[layer] = movesBetween(from[layer], slots, all, parts, layout.lattices[layer]);
      }
      return all;
    });
    return { ...slice, rows, moves, slots: passing?.slots };
  }

  /** @override @param {number} birth */
  whole(birth) {
    return { ...super.whole(birth), slots: this.passing?.slots };
  }

  /**
   * @override
   * @param {number} birth
   * @param {Uint8Array | null} mask
   * @param {number} layer
   * @param {Uint8Array} change
   */
  takes(birth, mask, layer, change) {
    if (layer < this.layout.numLayers - 1) return super.takes(birth, mask, layer, change);
    decodePassing(this, birth, change, this.history.of(birth));
    return true;
  }

  /**
   * @override
   * @param {number} birth
   * @param {number} layer
   * @param {Uint8Array} bytes
   */
  late(birth, layer, bytes) {
    if (layer === this.layout.numLayers - 1) return this.#latePassing(birth, bytes);
    const used = super.late(birth, layer, bytes);
    this.#showAgain(layer);
    return used;
  }

  /**
   * Applies a late passing slice whose frame shows already.
   * @param {number} birth
   * @param {Uint8Array} bytes
   */
  #latePassing(birth, bytes) {
    const history = this.#historyOfMissing;
    if (birth !== this.frame || history === null) return false;
    const passing = decodePassing(this, birth, bytes, history);
    for (const one of [this.passing, passing])
      for (const [layer, part] of one?.parts.entries() ?? []) this.alter(0, layer, part);
    this.passing = passing;
    this.#historyOfMissing = null;
    this.numMissing = 0;
    return true;
  }

  /**
   * @override
   * @param {Uint8Array} bytes
   * @param {number} [layer]
   * @param {number} [frame]
   */
  load(bytes, layer, frame) {
    const used = super.load(bytes, layer, frame);
    for (let n = 0; n < this.numLayers; n++) this.#showAgain(n);
    return used;
  }

  /** Shows a layer again after its slots changed; ignored if it no longer fits them. @param {number} layer */
  #showAgain(layer) {
    if (this.passing === null) return;
    try {
      show(this, this.passing, layer);
    } catch (error) {
      if (!(error instanceof FormatError)) throw error;
    }
  }
}

const none = new Uint8Array();

/** Adds all slots that `parts` do not keep. @param {Uint32Array} own @param {Uint8Array[]} parts */
function joined(own, parts) {
  const changed = new Uint8Array(parts[0].length);
  for (const row of own) changed[row] = 1;
  for (const part of parts) for (let i = 0; i < part.length; i++) changed[i] |= part[i];
  return changedRows(changed);
}

/** @param {SlotDecoder} decoder @param {Uint8Array} statuses of a lane */
function byLayer(decoder, statuses) {
  const { rowEdges } = decoder;
  return decoder.lanes[0].map((_, n) => statuses.subarray(rowEdges[n], rowEdges[n + 1]));
}

/**
 * Decodes the passing slice in `bytes`; null if they are empty. Throws a FormatError.
 * @param {SlotDecoder} decoder
 * @param {number} birth
 * @param {Uint8Array} bytes
 * @param {Uint8Array} history from `MaskHistory.of(birth)`, before the slice
 * @returns {Passing | null}
 */
function decodePassing(decoder, birth, bytes, history) {
  if (bytes.length === 0) return null;
  const { layout } = decoder;
  if (birth % layout.period === 0) throw corrupt(`passing: the slice born at ${birth} is none`);
  const { body, ...head } = readSlotHead(bytes, PASSING);
  expectChunk({ body, ...head }, birth, layout.numLayers - 1);
  const sizes = body.u32s(layout.numLayers);
  const [mask, ...changes] = Array.from(sizes, (size) => body.take(size));
  body.finish();
  const parts = byLayer(decoder, decodeMask(layout, birth, mask, history));
  const passing = { birth, parts, changes, next: null, slots: [...decoder.lanes[0]] };
  for (const [layer, change] of changes.entries()) {
    if (change.length > 0 && !parts[layer].some(Boolean))
      throw corrupt("passing: a change of a layer whose slots are all kept");
    show(decoder, passing, layer);
  }
  return passing;
}

/**
 * Applies a layer of a passing slice to the current slots, for display. Throws a FormatError.
 * @param {SlotDecoder} decoder
 * @param {Passing} passing
 * @param {number} layer
 */
function show(decoder, { birth, parts, changes, next, slots }, layer) {
  const stays = decoder.lanes[0][layer];
  slots[layer] = stays;
  const statuses = (next?.parts ?? parts)[layer];
  const change = changes[layer];
  if (next === null) {
    if (!statuses.some(Boolean)) return;
    const delta = deltaOf(decoder, birth, layer, statuses, change ?? none);
    slots[layer] = stays.copy();
    slots[layer].advance(delta);
  } else if (change && statuses.includes(PREDICTED)) {
    const delta = deltaOf(decoder, next.birth, layer, statuses, change);
    const lattice = decoder.layout.lattices[layer];
    slots[layer] = moved(stays, statuses, delta, lattice, next.share, parts[layer]);
  }
}

/**
 * @param {SlotDecoder} decoder
 * @param {number} birth
 * @param {number} layer
 * @param {Uint8Array} statuses
 * @param {Uint8Array} bytes
 */
function deltaOf({ layout, lanes }, birth, layer, statuses, bytes) {
  const counts = [0, 0, 0, 0];
  for (const status of statuses) counts[status]++;
  const change = decodeChange(layout, layer, birth, bytes, counts[PREDICTED], counts[NEW]);
  return lanes[0][layer].delta(statuses, change, layout.lattices[layer].opacityLevels);
}

/**
 * The transitions of the slots in `rows` between two shown states, see `movesOf`.
 * @param {Slots} before
 * @param {Slots} after
 * @param {Uint32Array} rows
 * @param {Uint8Array[]} parts statuses of the slices between the two states
 * @param {import("./slotlayout.js").Lattice} lattice
 */
function movesBetween(before, after, rows, parts, lattice) {
  const moves = new Uint8Array(rows.length);
  for (let i = 0; i < rows.length; i++) {
    const row = rows[i];
    let isSame = true;
    let numNew = 0;
    for (const part of parts) {
      if (part[row] === NEW) numNew++;
      else if (part[row] === ENDED) isSame = false;
    }
    // All parts refer to the same lasting slots, so a slot that is new in two parts may show one Gaussian.
    moves[i] = moveOf(before, row, after, row, isSame && numNew !== 1, lattice);
  }
  return moves;
}

/**
 * A replacement for a missing passing slice: predicted Gaussians are part of the way to the next slice.
 * Null if that slice is missing or corrupt; a corrupt one is reported when it is applied itself.
 * @param {SlotDecoder} decoder
 * @param {number} birth
 * @param {import("./slotdecoder.js").Ahead} [ahead]
 * @returns {Passing | null}
 */
function interpolated(decoder, birth, ahead) {
  const { layout } = decoder;
  const past = birth % layout.period;
  const following = birth - past + layout.period;
  const mask = ahead?.masks.get(following);
  const changes = ahead?.changes.get(following);
  if (!mask || !changes) return null;
  const history = new MaskHistory(layout);
  history.recent[0].set(decoder.history.recent[0]);
  for (let b = birth; b < following; b++) history.note(b, new Uint8Array(layout.numSlots));
  try {
    const said = byLayer(decoder, decodeMask(layout, following, mask, history.of(following)));
    const next = { birth: following, parts: said, share: past / layout.period };
    const parts = said.map((part) => new Uint8Array(part.length));
    const passing = { birth, parts, changes, next, slots: [...decoder.lanes[0]] };
    for (const layer of parts.keys()) show(decoder, passing, layer);
    return passing;
  } catch (error) {
    if (!(error instanceof FormatError)) throw error;
    return null;
  }
}

/**
 * The slots at `share` of the motion to `delta`.
 * @param {Slots} stays
 * @param {Uint8Array} statuses
 * @param {import("./slots.js").Delta} delta
 * @param {import("./slotlayout.js").Lattice} lattice
 * @param {number} share
 * @param {Uint8Array} part set to PREDICTED for the slots that move
 */
function moved(stays, statuses, delta, lattice, share, part) {
  const made = stays.copy();
  const width = made.numAttributes;
  const mix = (/** @type {number} */ a, /** @type {number} */ b) =>
    Math.floor((1 - share) * a + share * b + 0.5);
  for (let d = 0; d < delta.rows.length; d++) {
    const row = delta.rows[d];
    if (statuses[row] !== PREDICTED || stays.conditions[row] !== ON_LATTICE) continue;
    if (jumps(stays, row, delta, d, lattice)) continue;
    part[row] = PREDICTED;
    for (let axis = 0; axis < 3; axis++) {
      const at = 3 * row + axis;
      made.positions[at] = mix(stays.positions[at], delta.positions[3 * d + axis]);
    }
    const [first, last] = [width * row, width * d];
    let turned = 0;
    for (let n = 3; n < 6; n++)
      turned += signed(stays.attributes[first + n]) * signed(delta.attributes[last + n]);
    // w is never negative, so the other numbers change their signs when a rotation passes w = 0.
    const flips = turned * lattice.rotation ** 2 < -0.5;
    for (let n = 0; n < width - 1; n++) {
      if (flips && n >= 3 && n < 6) continue;
      const was = signed(stays.attributes[first + n]);
      made.attributes[first + n] = mix(was, signed(delta.attributes[last + n]));
    }
    const opacity = width - 1;
    made.attributes[first + opacity] = mix(
      stays.attributes[first + opacity],
      delta.attributes[last + opacity],
    );
  }
  return made;
}
