/** Gaussians as f32, and the lattices of a stream's slots (FORMAT.md, sections 2 and 8). */

import { MAX_LOGIT } from "../constants.js";
import { corrupt } from "./bytes.js";

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
    if (quats[i] === 0 && quats[i + 1] === 0 && quats[i + 2] === 0 && quats[i + 3] === 0)
      throw corrupt(`${what}: the quaternion of Gaussian ${i / 4} is zero`);
  }
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
    /** @type {number} */ this.swinSize = swinSize;
    /** @type {number} */ this.segmentFrames = segmentFrames;
    /** @type {number} */ this.shDegree = shDegree;
    /** @type {number[]} */ this.slots = slots;
    /** @type {Lattice[]} */ this.lattices = lattices;
    /** @type {number} */ this.k = numCoefficients(shDegree);
    /** Bytes of a Gaussian's attributes: scales, rotation, y, u, v, opacity. @type {number} */
    this.numAttributes = 7 + 3 * this.k;
    /** Number of slots of a lane, all layers together. @type {number} */
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
