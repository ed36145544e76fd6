/**
 * Gaussians as f32, the lattices of a stream's slots, and the way from one to the other (FORMAT.md, sections
 * 2 and 8).
 */

import { ESCAPED, MAX_LOGIT, ON_LATTICE } from "../constants.js";
import { corrupt } from "./bytes.js";
import { signed } from "./slots/slots.js";

/**
 * A set of N Gaussians as f32, one array per attribute.
 * @typedef {object} Gaussians
 * @property {Float32Array} means (N, 3) metres, world
 * @property {Float32Array} logScales (N, 3)
 * @property {Float32Array} quats (N, 4) w, x, y, z; not normalised
 * @property {Float32Array} logitOpacities (N)
 * @property {Float32Array} sh (N, K, 3) coefficient after coefficient, RGB
 */

/** Number of coefficients of a SH degree. @param {number} degree */
export function numCoefficients(degree) {
  return (degree + 1) ** 2;
}

/** @type {Map<number, Float32Array>} */
const tables = new Map();

/** The logit of every opacity level as f32. @param {number} levels 2 .. 256 */
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
 * Reads Gaussians stored as escapes (FORMAT.md, section 10.4).
 * @param {import("./bytes.js").ByteReader} reader @param {number} count @param {number} k coefficients
 * @returns {Gaussians}
 */
export function readGaussians(reader, count, k) {
  return {
    means: reader.f32s(3 * count),
    logScales: reader.f32s(3 * count),
    quats: reader.f32s(4 * count),
    logitOpacities: reader.f32s(count),
    sh: reader.f32s(3 * k * count),
  };
}

/**
 * Throws unless all numbers are finite and no quaternion is zero.
 * @param {Gaussians} gaussians @param {string} what named in the error
 */
export function checkGaussians(gaussians, what) {
  for (const [name, values] of Object.entries(gaussians)) {
    // In binary64 the sum of f32 is finite only if all of them are.
    let sum = 0;
    for (let i = 0; i < values.length; i++) sum += values[i];
    if (!Number.isFinite(sum)) throw corrupt(`${what}: a number of ${name} is not finite`);
  }
  const { quats } = gaussians;
  for (let i = 0; i < quats.length; i += 4) {
    if (quats[i] === 0 && quats[i + 1] === 0 && quats[i + 2] === 0 && quats[i + 3] === 0) {
      throw corrupt(`${what}: the quaternion of Gaussian ${i / 4} is zero`);
    }
  }
}

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

/**
 * The quantisation steps of one layer, all f32.
 * @typedef {object} Lattice
 * @property {number} positionM metres
 * @property {number} logScale @property {number} logScaleBase @property {number} rotation
 * @property {number} colour
 * @property {number} opacityLevels 2 .. 256
 */

/** The parameters that are needed to read skip maps, changes and keyframes. */
export class SlotLayout {
  /**
   * @param {number} swinSize number of lanes, and of frames that a lease lasts @param {number} segmentFrames
   * @param {number} shDegree @param {number[]} slots number of slots of a lane, for each layer
   * @param {Lattice[]} lattices of each layer
   */
  constructor(swinSize, segmentFrames, shDegree, slots, lattices) {
    this.swinSize = swinSize;
    this.segmentFrames = segmentFrames;
    this.shDegree = shDegree;
    this.slots = slots;
    this.lattices = lattices;
    this.k = numCoefficients(shDegree);
    /** Bytes of a Gaussian's attributes: scales, rotation, y, u, v, opacity. */
    this.numAttributes = 7 + 3 * this.k;
    /** Number of slots of a lane, all layers together. */
    this.numSlots = slots.reduce((sum, count) => sum + count, 0);
  }

  get numLayers() {
    return this.slots.length;
  }

  /** The lane of the slice born at `birth`. @param {number} birth */
  lane(birth) {
    return ((birth % this.swinSize) + this.swinSize) % this.swinSize;
  }

  /** First frame of the segment that contains the slice born at `birth`. @param {number} birth */
  segmentStart(birth) {
    return Math.floor(birth / this.segmentFrames) * this.segmentFrames;
  }

  /** Maximum size of a skip map. */
  get maxSkipMapBytes() {
    return 16 + 4 * this.numSlots;
  }

  /** Maximum size of a change of a layer. @param {number} layer */
  maxChangeBytes(layer) {
    return 32 + this.slots[layer] * this.#maxSlotBytes;
  }

  /** Maximum size of a keyframe of a layer. @param {number} layer */
  maxKeyframeBytes(layer) {
    const count = this.swinSize * this.slots[layer];
    return 32 + Math.ceil(count / 8) + count * this.#maxSlotBytes;
  }

  get #maxSlotBytes() {
    return 68 + 15 * this.k;
  }
}
