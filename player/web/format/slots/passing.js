/**
 * Passing slices: what shows in one frame and leaves the slots as they were (FORMAT.md, 2.1 and 10.5).
 * Loaded for streams with a temporal layer, as few have one.
 */

import { ENDED, JUMP_SIGMAS, NEW, ON_LATTICE, PREDICTED } from "../../constants.js";
import { FormatError, corrupt } from "../bytes/errors.js";
import { decodeChange } from "./change.js";
import { MaskHistory, decodeMask } from "./mask.js";
import { movesOf } from "./moves.js";
import { PASSING, expectChunk, readSlotHead } from "./slotchunk.js";

/** @typedef {import("./slots.js").Slots} Slots */

/**
 * A passing slice, and what its frame shows.
 * @typedef {object} Passing
 * @property {number} birth
 * @property {Uint8Array[]} parts the statuses of each layer
 * @property {Uint8Array[] | null} changes of each layer that has slots; null: it stands for a missing one
 * @property {Slots[]} slots
 */

/**
 * The decoder of a stream with a temporal layer.
 * @param {typeof import("./slotdecoder.js").SlotDecoder} Decoder of any other stream
 * @param {typeof FormatError} Refusal its FormatError
 */
export function passingDecoder(Decoder, Refusal) {
  /** @template T @param {() => T} action @returns {T} */
  const refusing = (action) => {
    try {
      return action();
    } catch (error) {
      if (error instanceof FormatError) throw new Refusal(error.kind, error.message);
      throw error;
    }
  };

  return class extends Decoder {
    /** @type {Passing | null} what shows if the last slice passes */
    passing = null;

    /**
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
      const passing = refusing(() => {
        if (!this.history.isReadable(birth)) return null;
        if (passes && decodeMask(layout, birth, mask ?? none, this.history.of(birth)).some(Boolean))
          throw corrupt("mask: a passing slice does not keep all slots");
        if (chunk !== null) return decodePassing(this, birth, chunk);
        return passes ? interpolated(this, birth, ahead) : null;
      });
      const before = this.passing;
      const shown = (before?.slots ?? this.lanes[0]).map((slots) => slots.copy());
      const said = passes || mask === null ? null : refusing(() => this.#statusesIn(birth, mask));
      const slice = super.apply(birth, passes ? none : mask, changes.slice(0, last));
      this.passing = passing;
      this.numMissing = passes && chunk === null ? 1 : 0;
      const { moves } = slice;
      const rows = slice.rows.map((of, layer) => {
        const parts = [passing?.parts, before?.parts].flatMap((one) => one?.[layer] ?? []);
        if (parts.length === 0) return of;
        const changed = new Set(of);
        for (const part of parts) part.forEach((status, row) => status && changed.add(row));
        const all = Uint32Array.from(changed).sort();
        const slots = passing?.slots[layer] ?? this.lanes[0][layer];
        const wasAltered = moves?.[layer].length !== of.length; // by bytes that came late
        if (said !== null) parts.push(said[layer]);
        if (moves !== undefined && !wasAltered)
          moves[layer] = movesBetween(shown[layer], slots, all, parts, layout.lattices[layer]);
        return all;
      });
      return { ...slice, rows, moves, slots: passing?.slots };
    }

    /**
     * The statuses of each layer in a mask; null if it cannot be read.
     * @param {number} birth
     * @param {Uint8Array} mask
     */
    #statusesIn(birth, mask) {
      if (!this.history.isReadable(birth)) return null;
      return byLayer(this, decodeMask(this.layout, birth, mask, this.history.of(birth)));
    }

    /** @param {number} birth */
    whole(birth) {
      return { ...super.whole(birth), slots: this.passing?.slots };
    }

    /**
     * @param {number} birth
     * @param {Uint8Array | null} mask
     * @param {number} layer
     * @param {Uint8Array} change
     */
    takes(birth, mask, layer, change) {
      if (layer < this.layout.numLayers - 1) return super.takes(birth, mask, layer, change);
      return refusing(() => decodePassing(this, birth, change)) !== undefined;
    }

    /**
     * @param {number} birth
     * @param {number} layer
     * @param {Uint8Array} bytes
     */
    late(birth, layer, bytes) {
      const used = super.late(birth, layer, bytes);
      this.#showAgain(layer);
      return used;
    }

    /**
     * @param {Uint8Array} bytes
     * @param {number} [layer]
     * @param {number} [frame]
     */
    load(bytes, layer, frame) {
      const used = super.load(bytes, layer, frame);
      for (let n = 0; n < this.numLayers; n++) this.#showAgain(n);
      return used;
    }

    /** Shows a layer upon its slots, which may be others; it is of no use if it does not fit them. @param {number} layer */
    #showAgain(layer) {
      if (this.passing === null) return;
      try {
        show(this, this.passing, layer);
      } catch (error) {
        if (!(error instanceof FormatError)) throw error;
      }
    }
  };
}

const none = new Uint8Array();

/** @typedef {import("./slotdecoder.js").SlotDecoder} SlotDecoder */

/** @param {SlotDecoder} decoder @param {Uint8Array} statuses of a lane */
function byLayer(decoder, statuses) {
  const { rowEdges } = decoder;
  return decoder.lanes[0].map((_, n) => statuses.subarray(rowEdges[n], rowEdges[n + 1]));
}

/**
 * The passing slice in `bytes`; null without any. Throws a FormatError.
 * @param {SlotDecoder} decoder
 * @param {number} birth
 * @param {Uint8Array} bytes
 * @returns {Passing | null}
 */
function decodePassing(decoder, birth, bytes) {
  if (bytes.length === 0) return null;
  const { layout, history } = decoder;
  if (birth % layout.period === 0) throw corrupt(`passing: the slice born at ${birth} is none`);
  const { body, ...head } = readSlotHead(bytes, PASSING);
  expectChunk({ body, ...head }, birth, layout.numLayers - 1);
  const sizes = body.u32s(layout.numLayers);
  const [mask, ...changes] = Array.from(sizes, (size) => body.take(size));
  body.finish();
  const parts = byLayer(decoder, decodeMask(layout, birth, mask, history.of(birth)));
  const passing = { birth, parts, changes, slots: [...decoder.lanes[0]] };
  for (const [layer, change] of changes.entries()) {
    if (change.length > 0 && !parts[layer].some(Boolean))
      throw corrupt("passing: a change of a layer whose slots are all kept");
    show(decoder, passing, layer);
  }
  return passing;
}

/**
 * Shows a layer of a passing slice upon the slots as they are. Throws a FormatError.
 * @param {SlotDecoder} decoder
 * @param {Passing} passing
 * @param {number} layer
 */
function show(decoder, { birth, parts, changes, slots }, layer) {
  const stays = decoder.lanes[0][layer];
  slots[layer] = stays;
  if (changes === null || !parts[layer].some(Boolean)) return;
  const delta = deltaOf(decoder, birth, layer, parts[layer], changes[layer]);
  slots[layer] = stays.copy();
  slots[layer].advance(delta);
}

/**
 * @param {SlotDecoder} decoder
 * @param {number} birth
 * @param {number} layer
 * @param {Uint8Array} statuses
 * @param {Uint8Array} bytes
 */
function deltaOf({ layout, lanes }, birth, layer, statuses, bytes) {
  const count = (/** @type {number} */ wanted) =>
    statuses.reduce((sum, status) => sum + (status === wanted ? 1 : 0), 0);
  const change = decodeChange(layout, layer, birth, bytes, count(PREDICTED), count(NEW));
  return lanes[0][layer].delta(statuses, change, layout.lattices[layer].opacityLevels);
}

/**
 * How the slots in `rows` come from what they showed to what they show, see `movesOf`.
 * @param {Slots} before
 * @param {Slots} after
 * @param {Uint32Array} rows
 * @param {Uint8Array[]} parts statuses of the slices that lie between
 * @param {import("./slotlayout.js").Lattice} lattice
 */
function movesBetween(before, after, rows, parts, lattice) {
  const width = after.numAttributes;
  const delta = {
    rows,
    conditions: Uint8Array.from(rows, (row) => after.conditions[row]),
    positions: new Int32Array(3 * rows.length),
    attributes: new Uint8Array(width * rows.length),
    starts: Uint8Array.from(rows, (row) => after.starts[row]),
    escapes: new Map(),
  };
  const statuses = new Uint8Array(after.count).fill(PREDICTED);
  rows.forEach((row, d) => {
    delta.positions.set(after.positions.subarray(3 * row, 3 * row + 3), 3 * d);
    delta.attributes.set(after.attributes.subarray(width * row, width * (row + 1)), width * d);
    if (parts.some((part) => part[row] === NEW || part[row] === ENDED)) statuses[row] = NEW;
  });
  return movesOf(before, delta, statuses, lattice);
}

/**
 * What stands for a passing slice that is missing: what goes on is on its way to the next slice.
 * Null if that is not here, or cannot be read, of which its own turn tells.
 * @param {SlotDecoder} decoder
 * @param {number} birth
 * @param {import("./slotdecoder.js").Ahead} [ahead]
 * @returns {Passing | null}
 */
function interpolated(decoder, birth, ahead) {
  const { layout } = decoder;
  const past = birth % layout.period;
  const next = birth - past + layout.period;
  const mask = ahead?.masks.get(next);
  const changes = ahead?.changes.get(next);
  if (!mask || !changes) return null;
  const history = new MaskHistory(layout);
  history.recent[0].set(decoder.history.recent[0]);
  for (let b = birth; b < next; b++) history.note(b, new Uint8Array(layout.numSlots));
  try {
    const said = byLayer(decoder, decodeMask(layout, next, mask, history.of(next)));
    const parts = said.map((part) => new Uint8Array(part.length));
    const slots = decoder.lanes[0].map((stays, layer) => {
      const change = changes[layer];
      if (!change || !said[layer].includes(PREDICTED)) return stays;
      const delta = deltaOf(decoder, next, layer, said[layer], change);
      const lattice = layout.lattices[layer];
      return moved(stays, said[layer], delta, lattice, past / layout.period, parts[layer]);
    });
    return { birth, parts, changes: null, slots };
  } catch (error) {
    if (!(error instanceof FormatError)) throw error;
    return null;
  }
}

/**
 * The slots when `share` of the way to `delta` is over.
 * @param {Slots} stays
 * @param {Uint8Array} statuses
 * @param {import("./slots.js").Delta} delta
 * @param {import("./slotlayout.js").Lattice} lattice
 * @param {number} share
 * @param {Uint8Array} part takes PREDICTED for those that move
 */
function moved(stays, statuses, delta, lattice, share, part) {
  const made = stays.copy();
  const width = made.numAttributes;
  delta.rows.forEach((row, d) => {
    if (statuses[row] !== PREDICTED || stays.conditions[row] !== ON_LATTICE) return;
    const first = numbers(stays, width, row);
    const last = numbers(delta, width, d);
    const away = Math.hypot(last[0] - first[0], last[1] - first[1], last[2] - first[2]);
    const scale = Math.max(...first.slice(3, 6), ...last.slice(3, 6));
    const longestM = Math.exp(scale * lattice.logScale + lattice.logScaleBase);
    if (away * lattice.positionM > JUMP_SIGMAS * longestM) return;
    // w is never negative: of a rotation that passes w = 0 the other numbers change their signs.
    const turned = first[6] * last[6] + first[7] * last[7] + first[8] * last[8];
    if (turned * lattice.rotation ** 2 < -0.5) last.splice(6, 3, ...first.slice(6, 9));
    const between = first.map((x, i) => Math.floor((1 - share) * x + share * last[i] + 0.5));
    made.positions.set(between.slice(0, 3), 3 * row);
    made.attributes.set(between.slice(3), width * row);
    part[row] = PREDICTED;
  });
  return made;
}

/**
 * A state as numbers: position, attributes, two's complement but for the opacity.
 * @param {{ positions: Int32Array, attributes: Uint8Array }} states
 * @param {number} width of the attributes
 * @param {number} i
 */
function numbers({ positions, attributes }, width, i) {
  const own = attributes.subarray(width * i, width * (i + 1));
  const signed = Array.from(own, (byte, n) => (n < width - 1 ? (byte << 24) >> 24 : byte));
  return [...positions.subarray(3 * i, 3 * i + 3), ...signed];
}
