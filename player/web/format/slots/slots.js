/** The slots of one layer in one lane, and how a slice changes them (FORMAT.md, section 7). */

import {
  EMPTY,
  ENDED,
  ENTERS,
  ESCAPED,
  HIDDEN,
  JUMP_SIGMAS,
  KEPT,
  LEAST_SPARE,
  MOVES,
  ON_LATTICE,
  POSITION_LIMIT,
  PREDICTED,
  SPARE_SHARE,
  UNKNOWN,
} from "../../constants.js";
import { corrupt } from "../bytes.js";

/**
 * The new states of D slots. They are computed before any slot is changed, so that bytes that break a rule
 * leave all slots unchanged.
 * @typedef {object} Delta
 * @property {Uint32Array} rows (D) the slots
 * @property {Uint8Array} conditions (D)
 * @property {Int32Array} positions (D, 3) zeros for slots without a Gaussian on the lattice
 * @property {Uint8Array} attributes (D, A) zeros for slots without a Gaussian on the lattice
 * @property {Uint8Array} starts (D) frames after the birth of the slice; HIDDEN without a Gaussian
 * @property {Map<number, Float32Array>} escapes by slot
 */

/** The rows that are not kept. @param {Uint8Array} statuses */
export function changedRows(statuses) {
  let count = 0;
  for (let i = 0; i < statuses.length; i++) if (statuses[i] !== KEPT) count++;
  const rows = new Uint32Array(count);
  for (let i = 0, at = 0; at < count; i++) if (statuses[i] !== KEPT) rows[at++] = i;
  return rows;
}

/**
 * The numbers of one of several Gaussians: mean, log scales, quaternion, logit, SH.
 * @param {import("../gaussians.js").Gaussians} from @param {number} i @param {number} k coefficients
 */
function gaussianAt(from, i, k) {
  const values = new Float32Array(11 + 3 * k);
  values.set(from.means.subarray(3 * i, 3 * i + 3), 0);
  values.set(from.logScales.subarray(3 * i, 3 * i + 3), 3);
  values.set(from.quats.subarray(4 * i, 4 * i + 4), 6);
  values[10] = from.logitOpacities[i];
  values.set(from.sh.subarray(3 * k * i, 3 * k * (i + 1)), 11);
  return values;
}

export class Slots {
  /** @param {number} count @param {number} numAttributes @param {number} condition of all of them */
  constructor(count, numAttributes, condition) {
    /** @type {number} */ this.count = count;
    /** @type {number} */ this.numAttributes = numAttributes;
    /** @type {Uint8Array} */ this.conditions = new Uint8Array(count).fill(condition);
    /** (count, 3) in steps of the lattice. @type {Int32Array} */
    this.positions = new Int32Array(3 * count);
    /** (count, A) two's complement, but the opacity, which comes last, is unsigned. @type {Uint8Array} */
    this.attributes = new Uint8Array(numAttributes * count);
    /** (count) frames after the birth of the lane's slice. @type {Uint8Array} */
    this.starts = new Uint8Array(count).fill(HIDDEN);
    /** @type {Map<number, Float32Array>} by slot */
    this.escapes = new Map();
  }

  /** Whether any slot is unknown. */
  get hasUnknown() {
    return this.conditions.includes(UNKNOWN);
  }

  /** Memory of the slots. */
  get numBytes() {
    const escapeBytes = this.escapes.size * 4 * (4 + this.numAttributes);
    return this.count * (2 + 12 + this.numAttributes) + escapeBytes;
  }

  copy() {
    const made = new Slots(0, this.numAttributes, UNKNOWN);
    made.count = this.count;
    made.conditions = this.conditions.slice();
    made.positions = this.positions.slice();
    made.attributes = this.attributes.slice();
    made.starts = this.starts.slice();
    made.escapes = new Map(this.escapes);
    return made;
  }

  /**
   * The changes of these slots by a slice. Throws a FormatError if the slice does not fit the slots.
   * @param {Uint8Array} statuses (count)
   * @param {import("./chunks.js").Change | null} change null if it is missing @param {number} opacityLevels
   * @returns {Delta}
   */
  delta(statuses, change, opacityLevels) {
    const rows = changedRows(statuses);
    const made = {
      rows,
      conditions: new Uint8Array(rows.length),
      positions: new Int32Array(3 * rows.length),
      attributes: new Uint8Array(this.numAttributes * rows.length),
      starts: new Uint8Array(rows.length).fill(HIDDEN),
      escapes: /** @type {Map<number, Float32Array>} */ (new Map()),
    };
    let numPredicted = 0;
    let numNew = 0;
    let numEscaped = 0;
    for (let d = 0; d < rows.length; d++) {
      const status = statuses[rows[d]];
      if (status === ENDED) {
        made.conditions[d] = EMPTY;
      } else if (change === null) {
        made.conditions[d] = UNKNOWN;
      } else if (status === PREDICTED) {
        this.#predict(made, d, change, numPredicted++, opacityLevels);
      } else {
        made.starts[d] = change.startOffsets[numNew];
        if (change.escapes[numEscaped] === numNew) {
          const k = (this.numAttributes - 7) / 3;
          made.conditions[d] = ESCAPED;
          made.escapes.set(rows[d], gaussianAt(change.floats, numEscaped++, k));
        } else {
          made.conditions[d] = ON_LATTICE;
          copyRow(change.positions, numNew, made.positions, d, 3);
          copyRow(change.attributes, numNew, made.attributes, d, this.numAttributes);
        }
        numNew++;
      }
    }
    return made;
  }

  /**
   * @param {Delta} made @param {number} d @param {import("./chunks.js").Change} change
   * @param {number} from index among the predicted slots @param {number} opacityLevels
   */
  #predict(made, d, change, from, opacityLevels) {
    const row = made.rows[d];
    const condition = this.conditions[row];
    if (condition === EMPTY || condition === ESCAPED) {
      const why = condition === EMPTY ? "is empty" : "has escaped";
      throw corrupt(`change: slot ${row} is predicted, but it ${why}`);
    }
    made.conditions[d] = condition;
    if (condition === UNKNOWN) return;
    made.starts[d] = 0;
    for (let axis = 0; axis < 3; axis++) {
      const q = this.positions[3 * row + axis] + change.moves[3 * from + axis];
      if (Math.abs(q) >= POSITION_LIMIT) throw corrupt(`change: slot ${row} leaves the lattice`);
      made.positions[3 * d + axis] = q;
    }
    const width = this.numAttributes;
    for (let i = 0; i < width; i++) {
      made.attributes[width * d + i] =
        this.attributes[width * row + i] + change.turns[width * from + i];
    }
    const opacity = made.attributes[width * (d + 1) - 1];
    if (opacity >= opacityLevels)
      throw corrupt(`change: slot ${row} has opacity ${opacity} of ${opacityLevels} levels`);
  }

  /** Applies a slice; Gaussians that are kept have started by now. @param {Delta} delta */
  advance(delta) {
    for (let i = 0; i < this.count; i++) if (this.conditions[i] >= ON_LATTICE) this.starts[i] = 0;
    const { rows } = delta;
    for (let d = 0; d < rows.length; d++) {
      const row = rows[d];
      this.conditions[row] = delta.conditions[d];
      this.starts[row] = delta.starts[d];
      copyRow(delta.positions, d, this.positions, row, 3);
      copyRow(delta.attributes, d, this.attributes, row, this.numAttributes);
      if (this.escapes.size > 0) this.escapes.delete(row);
    }
    for (const [row, values] of delta.escapes) this.escapes.set(row, values);
  }
}

/** A byte as two's complement. @param {number} byte */
export function signed(byte) {
  return (byte << 24) >> 24;
}

/**
 * @template {Int32Array | Uint8Array} T @param {T} from @param {number} fromRow @param {T} to
 * @param {number} toRow @param {number} width
 */
function copyRow(from, fromRow, to, toRow, width) {
  const a = fromRow * width;
  const b = toRow * width;
  for (let i = 0; i < width; i++) to[b + i] = from[a + i];
}

/** Flag in addition to MOVES or ENTERS: the previous Gaussian of the slot fades out. */
export const LEFT = 4;

/** Maximum number of Gaussians that can fade out at once. @param {number} numSlots of the stream */
export function spareSlots(numSlots) {
  return Math.max(LEAST_SPARE, Math.floor(numSlots / SPARE_SHARE));
}

/**
 * The transition of each slot that a slice changes: MOVES, ENTERS, or 0 if nothing shows yet; possibly
 * with LEFT (codec/slice.py).
 * @param {Slots} slots before the slice @param {Delta} delta @param {Uint8Array} statuses of the slots
 * @param {import("../gaussians.js").Lattice} lattice
 */
export function movesOf(slots, delta, statuses, lattice) {
  const { rows } = delta;
  const moves = new Uint8Array(rows.length);
  for (const [d, row] of rows.entries()) {
    const was = slots.conditions[row] >= ON_LATTICE;
    const is = delta.conditions[d] >= ON_LATTICE && delta.starts[d] === 0;
    const isSame = was && is && statuses[row] === PREDICTED;
    if (isSame && !jumps(slots, row, delta, d, lattice)) moves[d] = MOVES;
    else moves[d] = (is ? ENTERS : 0) | (was ? LEFT : 0);
  }
  return moves;
}

/**
 * Whether a Gaussian moves farther than JUMP_SIGMAS standard deviations along its longest axis.
 * @param {Slots} slots @param {number} row @param {Delta} next @param {number} d
 * @param {import("../gaussians.js").Lattice} lattice
 */
function jumps(slots, row, next, d, { positionM, logScale, logScaleBase }) {
  const width = slots.numAttributes;
  let squared = 0;
  let longest = -128;
  for (let axis = 0; axis < 3; axis++) {
    squared += (next.positions[3 * d + axis] - slots.positions[3 * row + axis]) ** 2;
    const size = signed(slots.attributes[width * row + axis]);
    longest = Math.max(longest, size, signed(next.attributes[width * d + axis]));
  }
  const limitM = JUMP_SIGMAS * Math.exp(longest * logScale + logScaleBase);
  return positionM * Math.sqrt(squared) > limitM;
}
