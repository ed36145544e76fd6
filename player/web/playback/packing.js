/** Packs changed Gaussians for the renderer and the sorter. */

import { opacityLogits } from "../format/gaussians.js";
import { NEVER } from "./depthorder.js";
import { ALPHA_MIN, ENTERS, ESCAPED, ON_LATTICE } from "../constants.js";
import { LEFT, spareSlots } from "../format/slots/slots.js";
import { floatWords, latticeWords, roomFor } from "./words.js";

/** A Gaussian with a smaller logit is nowhere opaque enough to show, and is omitted from every frame. */
const LEAST_LOGIT = Math.log(ALPHA_MIN / (1 - ALPHA_MIN));

/**
 * Slots whose Gaussians change at a frame.
 * @typedef {object} SplatUpdate
 * @property {number} frame
 * @property {Uint32Array} lattice words of the Gaussians on the lattice, see renderer/resident.js
 * @property {Uint32Array} floats words of the other Gaussians
 * @property {Uint32Array} slots (N)
 * @property {Float32Array} means (N, 3) metres
 * @property {Int32Array} starts (N) the first frame that shows each, or NEVER
 * @property {Uint8Array} moves (N) transition of each: MOVES, ENTERS, or 0 for an immediate change
 * @property {Uint32Array} leaving slots whose Gaussians fade out, if they showed
 */

/** The buffers of an update, to be transferred to another thread. @param {SplatUpdate} update */
export function buffersOf(update) {
  const { lattice, floats, slots, means, starts, moves, leaving } = update;
  return [lattice, floats, slots, means, starts, moves, leaving].map(
    (array) => /** @type {ArrayBuffer} */ (array.buffer),
  );
}

/**
 * Packs the changes of a lane.
 * @param {import("../format/slots/slotdecoder.js").SlotDecoder} decoder
 * @param {import("../format/slots/slotdecoder.js").SlotSlice} slice
 * @param {number} frame from which they show @returns {SplatUpdate}
 */
export function packSlots(decoder, slice, frame) {
  const { layout, rowEdges } = decoder;
  const lane = decoder.lanes[slice.lane];
  let count = 0;
  let numLattice = 0;
  let numFloats = 0;
  let numLeaving = 0;
  for (const [layer, rows] of slice.rows.entries()) {
    const { conditions } = lane[layer];
    for (const move of slice.moves?.[layer] ?? []) if (move & LEFT) numLeaving++;
    count += rows.length;
    for (const row of rows) {
      if (conditions[row] === ON_LATTICE) numLattice++;
      else if (conditions[row] === ESCAPED) numFloats++;
    }
  }
  // If more Gaussians are replaced than can fade out, all of them change at once.
  const fades = numLeaving <= spareSlots(layout.numSlots);
  const packer = new Packer(layout.shDegree, frame, count, numLattice, numFloats);
  for (const [layer, rows] of slice.rows.entries()) {
    const slots = lane[layer];
    const first = slice.lane * layout.numSlots + rowEdges[layer];
    const lattice = layout.lattices[layer];
    const logits = opacityLogits(lattice.opacityLevels);
    const moves = slice.moves?.[layer];
    for (const [i, row] of rows.entries()) {
      const move = moves?.[i] ?? 0;
      packer.move = move & ~LEFT;
      if (!fades && packer.move === ENTERS) packer.move = 0;
      if (fades && move & LEFT) packer.leaving.push(first + row);
      const start = slice.birth + slots.starts[row];
      if (slots.conditions[row] === ON_LATTICE) {
        packer.addLattice(first + row, layer, slots, row, start, lattice, logits);
      } else if (slots.conditions[row] === ESCAPED) {
        const values = slots.escapes.get(row);
        if (values === undefined) throw new Error("an escaped slot without its numbers");
        packer.addFloats(first + row, values, start);
      } else {
        packer.addNothing(first + row);
      }
    }
  }
  packer.update.leaving = Uint32Array.from(packer.leaving);
  return packer.update;
}

class Packer {
  /** @type {number[]} */
  leaving = [];
  /** Transition of the Gaussian that is added next. */
  move = 0;
  at = 0;
  atLattice = 0;
  atFloats = 0;

  /**
   * @param {number} shDegree @param {number} frame @param {number} count @param {number} numLattice
   * @param {number} numFloats
   */
  constructor(shDegree, frame, count, numLattice, numFloats) {
    this.latticeWords = latticeWords(shDegree);
    this.floatWords = floatWords(shDegree);
    /** @type {SplatUpdate} */
    this.update = {
      frame,
      lattice: roomFor(numLattice, this.latticeWords),
      floats: roomFor(numFloats, this.floatWords),
      slots: new Uint32Array(count),
      means: new Float32Array(3 * count),
      starts: new Int32Array(count),
      moves: new Uint8Array(count),
      leaving: new Uint32Array(),
    };
    this.latticeBytes = new Uint8Array(this.update.lattice.buffer);
    this.floatValues = new Float32Array(this.update.floats.buffer);
  }

  /** @param {number} slot */
  addNothing(slot) {
    this.#add(slot, NEVER);
  }

  /**
   * @param {number} slot @param {number} layer @param {import("../format/slots/slots.js").Slots} slots
   * @param {number} row @param {number} start @param {import("../format/gaussians.js").Lattice} lattice
   * @param {Float32Array} logits
   */
  addLattice(slot, layer, slots, row, start, lattice, logits) {
    const { positions, attributes, numAttributes } = slots;
    const { means, lattice: words } = this.update;
    const word = this.latticeWords * this.atLattice++;
    const from = numAttributes * row;
    for (let axis = 0; axis < 3; axis++) {
      const q = positions[3 * row + axis];
      words[word + axis] = (q << 8) | attributes[from + axis];
      means[3 * this.at + axis] = q * lattice.positionM;
    }
    words[word + 3] = (this.move << 28) | (layer << 24) | slot;
    const to = 4 * (word + 4) - 3;
    for (let i = 3; i < numAttributes; i++) this.latticeBytes[to + i] = attributes[from + i];
    const logit = logits[attributes[from + numAttributes - 1]];
    this.#add(slot, logit >= LEAST_LOGIT ? start : NEVER);
  }

  /**
   * @param {number} slot @param {Float32Array} values mean, log scales, quaternion, logit, harmonics
   * @param {number} start
   */
  addFloats(slot, values, start) {
    const word = this.floatWords * this.atFloats++;
    this.update.floats[word] = (this.move << 28) | slot;
    this.floatValues.set(values, word + 1);
    this.update.means.set(values.subarray(0, 3), 3 * this.at);
    this.#add(slot, values[10] >= LEAST_LOGIT ? start : NEVER);
  }

  /** @param {number} slot @param {number} start */
  #add(slot, start) {
    this.update.slots[this.at] = slot;
    this.update.moves[this.at] = this.move;
    this.update.starts[this.at] = start;
    this.at++;
  }
}
