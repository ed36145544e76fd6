/** From chunks to the Gaussians that change at a frame, packed for the renderer and the sorter. */

import { ALPHA_MIN, ENTERS, ESCAPED, ON_LATTICE } from "../constants.js";
import { FormatError } from "../format/bytes.js";
import { opacityLogits } from "../format/gaussians.js";
import { SlotDecoder } from "../format/slots/slotdecoder.js";
import { LEFT, spareSlots } from "../format/slots/slots.js";
import { floatWords, latticeWords, NEVER, roomFor } from "./depthorder.js";

/**
 * The received chunks of a stream, and the slots that result from them, frame by frame.
 * Chunks may arrive in any order, and are used even if their frame has already shown.
 */
export class FrameAssembler {
  /** @type {Map<number, Uint8Array>} by birth */
  skipMaps = new Map();
  /** @type {Map<number, (Uint8Array | null)[]>} by birth; one chunk per layer */
  changes = new Map();
  /** @type {Map<number, (Uint8Array | null)[]>} by first frame of a segment; one chunk per layer */
  keyframes = new Map();
  /** Number of chunks that were refused and so are missing in their layers. */
  refused = 0;
  /** @type {(birth: number, layer: number, why: unknown) => void} called for each of them */
  onLost = () => {};
  /** Whether a late chunk has changed the current frame since the whole frame was last returned. */
  isLate = false;

  /** @param {import("../format/manifest.js").Manifest} manifest */
  constructor(manifest) {
    this.layout = manifest.layout;
    this.decoder = new SlotDecoder(this.layout);
  }

  /** The last decoded frame; null before the first. */
  get frame() {
    return this.decoder.frame;
  }

  /** Number of layers that show completely. */
  get layers() {
    const { numLayers } = this.layout;
    for (let layer = 0; layer < numLayers; layer++) if (this.#lacksAnything(layer)) return layer;
    return numLayers;
  }

  /** @param {number} layer */
  #lacksAnything(layer) {
    return this.decoder.lanes.some((lane) => lane[layer].hasUnknown);
  }

  /** @param {number} birth @param {Uint8Array} chunk empty if all slots are kept */
  addSkipMap(birth, chunk) {
    if (this.frame === null || birth > this.frame) this.skipMaps.set(birth, chunk);
  }

  /** @param {number} birth @param {number} layer @param {Uint8Array} chunk empty if nothing changes */
  addChange(birth, layer, chunk) {
    if (this.frame === null || birth > this.frame) this.#row(this.changes, birth)[layer] = chunk;
    else this.#tryLate(birth, layer, () => this.decoder.late(birth, layer, chunk));
  }

  /** @param {number} frame @param {number} layer @param {Uint8Array} chunk */
  addKeyframe(frame, layer, chunk) {
    if (this.frame === null || frame > this.frame) this.#row(this.keyframes, frame)[layer] = chunk;
    else if (frame === this.layout.segmentStart(this.frame)) {
      this.#tryLate(frame, layer, () => this.decoder.load(chunk, layer, frame));
    }
  }

  /** Whether the skip map and layer 0's change of a slice have arrived. @param {number} birth */
  hasSlice(birth) {
    return this.skipMaps.has(birth) && Boolean(this.changes.get(birth)?.[0]);
  }

  /** Whether `advance` is possible for `frame`. @param {number} frame @param {number} numFrames of the stream */
  canAdvance(frame, numFrames) {
    return this.hasSlice(frame) || this.#canRejoin(frame, numFrames);
  }

  /**
   * Whether a segment whose first slice is missing can be joined by its keyframe. As long as the first
   * slice may still arrive, it is better to wait for it, because it continues the current Gaussians.
   * @param {number} frame @param {number} numFrames
   */
  #canRejoin(frame, numFrames) {
    if (!this.keyframes.get(frame)?.[0]) return false;
    return frame + 1 >= numFrames || this.hasSlice(frame + 1);
  }

  /** Whether `join` is possible for `frame`: layer 0 has all it needs. @param {number} frame */
  has(frame) {
    const first = this.layout.segmentStart(frame);
    if (!this.keyframes.get(first)?.[0]) return false;
    for (let birth = first + 1; birth <= frame; birth++) if (!this.hasSlice(birth)) return false;
    return true;
  }

  /** Begins with `frame`, and returns all of it. Throws a FormatError if layer 0 is refused. @param {number} frame */
  join(frame) {
    const first = this.layout.segmentStart(frame);
    this.decoder = new SlotDecoder(this.layout);
    this.skipMaps.delete(first);
    this.changes.delete(first);
    this.#load(first);
    for (let birth = first + 1; birth <= frame; birth++) this.#apply(birth, birth === frame);
    return this.again(frame);
  }

  /** The whole current frame, including late chunks. @param {number} frame the current one */
  again(frame) {
    this.isLate = false;
    return this.decoder.handOut().map((slice) => packSlots(this.decoder, slice, frame));
  }

  /**
   * Advances by one frame, and returns its changes, or all of it after a rejoin. Throws a FormatError if
   * the frame's skip map is refused.
   * @param {number} frame
   */
  advance(frame) {
    if (!this.hasSlice(frame) && this.keyframes.get(frame)?.[0])
      return { isJoin: true, updates: this.join(frame) };
    const slice = this.#apply(frame, true);
    if (frame === this.layout.segmentStart(frame)) this.#load(frame);
    return { isJoin: false, updates: [packSlots(this.decoder, slice, frame)] };
  }

  /** @param {number} birth @param {boolean} shows whether the frame shows */
  #apply(birth, shows) {
    const skipMap = this.skipMaps.get(birth) ?? null;
    const changes = this.#row(this.changes, birth);
    this.skipMaps.delete(birth);
    this.changes.delete(birth);
    try {
      return this.decoder.apply(birth, skipMap, changes, shows);
    } catch (error) {
      if (!(error instanceof FormatError)) throw error;
    }
    // A change that is refused counts as missing (FORMAT.md, section 7).
    const taken = changes.map((change, layer) => {
      const takes = () =>
        this.decoder.takes(birth, skipMap, layer, /** @type {Uint8Array} */ (change));
      return change !== null && this.#try(birth, layer, takes) ? change : null;
    });
    return this.decoder.apply(birth, skipMap, taken, shows);
  }

  /** Loads the keyframes of `frame` for layers that lack something. @param {number} frame */
  #load(frame) {
    const chunks = this.keyframes.get(frame) ?? [];
    for (const [layer, chunk] of chunks.entries()) {
      if (chunk === null || (this.frame !== null && !this.#lacksAnything(layer))) continue;
      if (layer === 0 && this.frame === null) this.decoder.load(chunk, layer, frame);
      else this.#try(frame, layer, () => this.decoder.load(chunk, layer, frame));
    }
    for (const known of this.keyframes.keys()) if (known <= frame) this.keyframes.delete(known);
  }

  /** Notes that a chunk is damaged. @param {number} birth @param {number} layer @param {unknown} why */
  lose(birth, layer, why) {
    this.refused += 1;
    this.onLost(birth, layer, why);
  }

  /**
   * @param {number} birth @param {number} layer
   * @param {() => boolean} action returns whether it changed the current frame
   */
  #tryLate(birth, layer, action) {
    if (this.#try(birth, layer, action)) this.isLate = true;
  }

  /** @param {number} birth @param {number} layer @param {() => boolean} action */
  #try(birth, layer, action) {
    try {
      return action();
    } catch (error) {
      if (!(error instanceof FormatError)) throw error;
      this.lose(birth, layer, error);
      return false;
    }
  }

  /** @param {Map<number, (Uint8Array | null)[]>} table @param {number} key */
  #row(table, key) {
    let row = table.get(key);
    if (row === undefined) {
      row = new Array(this.layout.numLayers).fill(null);
      table.set(key, row);
    }
    return row;
  }
}

/** A Gaussian with a smaller logit is nowhere opaque enough to show, and is omitted from every frame. */
const LEAST_LOGIT = Math.log(ALPHA_MIN / (1 - ALPHA_MIN));

/**
 * Slots whose Gaussians change at a frame.
 * @typedef {object} SplatUpdate
 * @property {number} frame
 * @property {Uint32Array} lattice words of the Gaussians on the lattice, see renderer/splatrenderer.js
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
function packSlots(decoder, slice, frame) {
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
    /** @type {number} */ this.latticeWords = latticeWords(shDegree);
    /** @type {number} */ this.floatWords = floatWords(shDegree);
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
