/** The number and the lattices of a stream's slots (FORMAT.md, sections 2 and 8). */

import { numCoefficients } from "../gaussians.js";

/**
 * The quantisation steps of one layer, all f32.
 * @typedef {object} Lattice
 * @property {number} positionM metres
 * @property {number} logScale
 * @property {number} logScaleBase
 * @property {number} rotation
 * @property {number} colour
 * @property {number} opacityLevels 2 .. 256
 */

/** The parameters that are needed to read masks, changes and snapshots. */
export class SlotLayout {
  /**
   * @param {number} swinSize number of lanes, and of frames that a lease lasts
   * @param {number} segmentFrames
   * @param {number} shDegree
   * @param {number[]} slots number of slots of a lane, for each layer
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

  /** Maximum size of a mask. */
  get maxMaskBytes() {
    return 16 + 4 * this.numSlots;
  }

  /** Maximum size of a change of a layer. @param {number} layer */
  maxChangeBytes(layer) {
    return 32 + this.slots[layer] * this.#maxSlotBytes;
  }

  /** Maximum size of a snapshot of a layer. @param {number} layer */
  maxSnapshotBytes(layer) {
    const count = this.swinSize * this.slots[layer];
    return 32 + Math.ceil(count / 8) + count * this.#maxSlotBytes;
  }

  get #maxSlotBytes() {
    return 68 + 15 * this.k;
  }
}
