/** Converts lattice numbers to f32 (FORMAT.md, section 8). */

import { MAX_LOGIT } from "../constants.js";

const { fround, max, sqrt } = Math;

/** @type {Map<number, Float32Array>} */
const tables = new Map();

/**
 * The logit of every opacity level as f32.
 * @param {number} levels 2 .. 256
 */
export function opacityLogits(levels) {
  let table = tables.get(levels);
  if (table === undefined) {
    table = new Float32Array(levels);
    for (let o = 1; o < levels - 1; o++) table[o] = Math.log(o / (levels - 1 - o));
    table[0] = -MAX_LOGIT;
    table[levels - 1] = MAX_LOGIT;
    tables.set(levels, table);
  }
  return table;
}

/**
 * Stores the unit quaternion with the given x, y, z; w follows from them.
 * @param {Float32Array} quats
 * @param {number} i
 * @param {number} x
 * @param {number} y
 * @param {number} z
 */
export function putQuat(quats, i, x, y, z) {
  const square = fround(fround(fround(x * x) + fround(y * y)) + fround(z * z));
  quats[4 * i] = sqrt(max(fround(1 - square), 0));
  quats[4 * i + 1] = x;
  quats[4 * i + 2] = y;
  quats[4 * i + 3] = z;
}

/**
 * Stores the RGB of a luma and two colour differences.
 * @param {Float32Array} sh
 * @param {number} at
 * @param {number} y
 * @param {number} co
 * @param {number} cg
 */
export function putColour(sh, at, y, co, cg) {
  const rest = fround(y - cg);
  sh[at] = rest + co;
  sh[at + 1] = y + cg;
  sh[at + 2] = rest - co;
}
