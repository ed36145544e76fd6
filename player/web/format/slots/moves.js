import {
  ENTERS,
  JUMP_SIGMAS,
  LEAST_SPARE,
  MOVES,
  ON_LATTICE,
  PREDICTED,
  SPARE_SHARE,
} from "../../constants.js";
import { signed } from "./slots.js";

/** Flag in addition to MOVES or ENTERS: the previous Gaussian of the slot fades out. */
export const LEFT = 4;

/** Maximum number of Gaussians that can fade out at once. @param {number} numSlots of the stream */
export function spareSlots(numSlots) {
  return Math.max(LEAST_SPARE, Math.floor(numSlots / SPARE_SHARE));
}

/**
 * The transition of each slot that a slice changes: MOVES, ENTERS, or 0 if nothing shows yet; possibly
 * with LEFT (codec/halfway.py).
 * @param {import("./slots.js").Slots} slots before the slice
 * @param {import("./slots.js").Delta} delta
 * @param {Uint8Array} statuses of the slots
 * @param {import("./slotlayout.js").Lattice} lattice
 */
export function movesOf(slots, delta, statuses, lattice) {
  const { rows } = delta;
  const moves = new Uint8Array(rows.length);
  for (let d = 0; d < rows.length; d++)
    moves[d] = moveOf(slots, rows[d], delta, d, statuses[rows[d]] === PREDICTED, lattice);
  return moves;
}

/** @typedef {Pick<import("./slots.js").Delta, "conditions" | "positions" | "attributes" | "starts">} States */

/**
 * The transition of slot `row` to state `d` of `next`, see `movesOf`.
 * @param {import("./slots.js").Slots} slots
 * @param {number} row
 * @param {States} next
 * @param {number} d
 * @param {boolean} isSame whether it is the same Gaussian
 * @param {import("./slotlayout.js").Lattice} lattice
 */
export function moveOf(slots, row, next, d, isSame, lattice) {
  const was = slots.conditions[row] >= ON_LATTICE;
  const is = next.conditions[d] >= ON_LATTICE && next.starts[d] === 0;
  if (was && is && isSame && !jumps(slots, row, next, d, lattice)) return MOVES;
  return (is ? ENTERS : 0) | (was ? LEFT : 0);
}

/**
 * Whether a Gaussian moves farther than JUMP_SIGMAS standard deviations along its longest axis.
 * @param {import("./slots.js").Slots} slots
 * @param {number} row
 * @param {States} next
 * @param {number} d
 * @param {import("./slotlayout.js").Lattice} lattice
 */
export function jumps(slots, row, next, d, { positionM, logScale, logScaleBase }) {
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
