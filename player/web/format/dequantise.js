/** The way from the lattices of slots to Gaussians as f32 (FORMAT.md, section 8): not on the way to a picture. */

import { ESCAPED, ON_LATTICE } from "../constants.js";
import { opacityLogits } from "./gaussians.js";
import { signed } from "./slots/slots.js";

/** @typedef {import("./gaussians.js").Gaussians} Gaussians */
/** @typedef {import("./gaussians.js").Lattice} Lattice */

const { fround, max, sqrt } = Math;

/**
 * The Gaussians of the slots `rows` as f32; all zeros, also the quaternion, for slots without one.
 * @param {import("./slots/slots.js").Slots} slots @param {Uint32Array} rows @param {Lattice} lattice
 */
export function gaussiansOf(slots, rows, lattice) {
  const k = (slots.numAttributes - 7) / 3;
  const made = emptyGaussians(rows.length, k);
  const logits = opacityLogits(lattice.opacityLevels);
  for (let i = 0; i < rows.length; i++) {
    const row = rows[i];
    if (slots.conditions[row] === ON_LATTICE) dequantise(slots, row, lattice, logits, made, i, k);
    else if (slots.conditions[row] === ESCAPED) putGaussian(slots.escapes.get(row), made, i, k);
  }
  return made;
}

/**
 * @param {import("./slots/slots.js").Slots} slots @param {number} row @param {Lattice} lattice
 * @param {Float32Array} logits @param {Gaussians} made @param {number} i @param {number} k
 */
function dequantise({ positions, attributes, numAttributes }, row, lattice, logits, made, i, k) {
  const at = numAttributes * row;
  for (let axis = 0; axis < 3; axis++) {
    made.means[3 * i + axis] = positions[3 * row + axis] * lattice.positionM;
    const scaled = fround(signed(attributes[at + axis]) * lattice.logScale);
    made.logScales[3 * i + axis] = scaled + lattice.logScaleBase;
  }
  const x = fround(signed(attributes[at + 3]) * lattice.rotation);
  const y = fround(signed(attributes[at + 4]) * lattice.rotation);
  const z = fround(signed(attributes[at + 5]) * lattice.rotation);
  putQuat(made.quats, i, x, y, z);
  for (let c = 0; c < k; c++) {
    const luma = fround(signed(attributes[at + 6 + c]) * lattice.colour);
    const co = fround(signed(attributes[at + 6 + k + c]) * lattice.colour);
    const cg = fround(signed(attributes[at + 6 + 2 * k + c]) * lattice.colour);
    putColour(made.sh, 3 * (i * k + c), luma, co, cg);
  }
  made.logitOpacities[i] = logits[attributes[at + numAttributes - 1]];
}

/**
 * @param {Float32Array | undefined} values mean, log scales, quaternion, logit, SH @param {Gaussians} made
 * @param {number} i @param {number} k coefficients
 */
function putGaussian(values, made, i, k) {
  if (values === undefined) throw new Error("an escaped slot without its numbers");
  made.means.set(values.subarray(0, 3), 3 * i);
  made.logScales.set(values.subarray(3, 6), 3 * i);
  made.quats.set(values.subarray(6, 10), 4 * i);
  made.logitOpacities[i] = values[10];
  made.sh.set(values.subarray(11), 3 * k * i);
}

/** Allocates N Gaussians. @param {number} count @param {number} k coefficients @returns {Gaussians} */
function emptyGaussians(count, k) {
  return {
    means: new Float32Array(3 * count),
    logScales: new Float32Array(3 * count),
    quats: new Float32Array(4 * count),
    logitOpacities: new Float32Array(count),
    sh: new Float32Array(3 * k * count),
  };
}

/**
 * Stores the unit quaternion with the given x, y, z; w follows from them.
 * @param {Float32Array} quats @param {number} i @param {number} x @param {number} y @param {number} z
 */
function putQuat(quats, i, x, y, z) {
  const square = fround(fround(fround(x * x) + fround(y * y)) + fround(z * z));
  quats[4 * i] = sqrt(max(fround(1 - square), 0));
  quats[4 * i + 1] = x;
  quats[4 * i + 2] = y;
  quats[4 * i + 3] = z;
}

/**
 * Stores the RGB of a luma and two colour differences.
 * @param {Float32Array} sh @param {number} at @param {number} y @param {number} co @param {number} cg
 */
function putColour(sh, at, y, co, cg) {
  const rest = fround(y - cg);
  sh[at] = rest + co;
  sh[at + 1] = y + cg;
  sh[at + 2] = rest - co;
}
