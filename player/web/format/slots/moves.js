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
 * @param {import("./slots.js").Slots} slots
 * @param {number} row
 * @param {import("./slots.js").Delta} next
 * @param {number} d
 * @param {import("./slotlayout.js").Lattice} lattice
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
