/** The order in which Gaussians are drawn, and the changes that wait for it. */

import { MOVES } from "../constants.js";

/** Start value of a Gaussian that no frame shows. */
export const NEVER = 2 ** 31 - 1;

const DIGIT_BITS = 11;
const NUM_VALUES = 1 << DIGIT_BITS;

/** Computes which Gaussians show in a frame, farthest first (player/render/order.py). */
export class DepthOrder {
  /** Number of Gaussians that fade out. */
  numLeft = 0;
  counts = new Uint32Array(3 * NUM_VALUES);

  /** @param {number} numSlots @param {number} numSpare places after the slots, for Gaussians that fade out */
  constructor(numSlots, numSpare = 0) {
    /** @type {number} */ this.numSlots = numSlots;
    const total = numSlots + numSpare;
    /** @type {Float32Array} */ this.means = new Float32Array(3 * total);
    /** @type {Int32Array} */ this.starts = new Int32Array(total).fill(NEVER);
    /** @type {Float32Array} */ this.depths = new Float32Array(total);
    this.keys = [new Uint32Array(this.depths.buffer), new Uint32Array(total)];
    this.slots = [new Uint32Array(total), new Uint32Array(total)];
  }

  /**
   * Replaces the Gaussians of some slots.
   * @param {Uint32Array} slots @param {Float32Array} means (N, 3) metres
   * @param {Int32Array} starts (N) the first frame that shows each, or NEVER
   * @param {Uint8Array} [moves] (N) Gaussians with MOVES count as half way there until the next `put`
   */
  put(slots, means, starts, moves) {
    for (let i = 0; i < slots.length; i++) {
      const slot = slots[i];
      const back = moves?.[i] === MOVES ? 0.5 : 0;
      for (let n = 0; n < 3; n++) {
        const at = 3 * slot + n;
        this.means[at] = back * this.means[at] + (1 - back) * means[3 * i + n];
      }
      this.starts[slot] = starts[i];
    }
  }

  /**
   * Copies the Gaussians of `slots` that show before `frame` to the spare places, replacing what is there.
   * Returns their slots, padded to whole texels.
   * @param {Uint32Array} slots @param {number} frame
   */
  leave(slots, frame) {
    const { means, starts, numSlots } = this;
    starts.fill(NEVER, numSlots);
    const left = slots.filter((slot) => starts[slot] < frame);
    this.numLeft = left.length;
    for (const [n, slot] of left.entries()) {
      means.copyWithin(3 * (numSlots + n), 3 * slot, 3 * slot + 3);
      starts[numSlots + n] = frame;
    }
    const padded = roomFor(left.length, 1);
    padded.set(left);
    return padded;
  }

  /**
   * The slots to draw, as a copy; in two bytes each if they fit.
   * @param {number} frame @param {number[]} w2c (4, 4) world to camera, metres @param {number} nearM
   */
  farFirst(frame, w2c, nearM) {
    const { means, starts, depths } = this;
    const slots = this.slots[0];
    const [a, b, c, d] = w2c.slice(8, 12);
    let found = 0;
    // The last slot first: at equal depth the lower slot is in front, as in the CPU renderer.
    for (let slot = starts.length - 1; slot >= 0; slot--) {
      if (starts[slot] > frame) continue;
      const z = a * means[3 * slot] + b * means[3 * slot + 1] + c * means[3 * slot + 2] + d;
      if (z <= nearM) continue;
      slots[found] = slot;
      depths[found] = z;
      found++;
    }
    this.#sort(found);
    const order = this.slots[1].subarray(0, found);
    return this.numSlots + this.numLeft <= 2 ** 16 ? new Uint16Array(order) : order.slice();
  }

  /**
   * A stable radix sort of the first `count` keys by decreasing depth. It uses that the bits of positive
   * floats grow with their value. The result is in slots[1].
   * @param {number} count
   */
  #sort(count) {
    const { counts } = this;
    let [keys, spareKeys] = this.keys;
    let [slots, spareSlots] = this.slots;
    counts.fill(0);
    for (let i = 0; i < count; i++) {
      const key = ~keys[i] >>> 0;
      keys[i] = key;
      counts[key & (NUM_VALUES - 1)]++;
      counts[NUM_VALUES + ((key >>> DIGIT_BITS) & (NUM_VALUES - 1))]++;
      counts[2 * NUM_VALUES + (key >>> (2 * DIGIT_BITS))]++;
    }
    for (let digit = 0; digit < 3; digit++) {
      const first = digit * NUM_VALUES;
      for (let value = 0, total = 0; value < NUM_VALUES; value++) {
        const here = counts[first + value];
        counts[first + value] = total;
        total += here;
      }
      const shift = digit * DIGIT_BITS;
      for (let i = 0; i < count; i++) {
        const to = counts[first + ((keys[i] >>> shift) & (NUM_VALUES - 1))]++;
        spareKeys[to] = keys[i];
        spareSlots[to] = slots[i];
      }
      [keys, spareKeys] = [spareKeys, keys];
      [slots, spareSlots] = [spareSlots, slots];
    }
  }
}

/** Words, of 32 bits, of an uploaded Gaussian on the lattice. @param {number} shDegree */
export function latticeWords(shDegree) {
  const numBytes = 4 + 3 * (shDegree + 1) ** 2; // the log scales lie with the position
  return 4 + Math.ceil(numBytes / 4);
}

/** Words of an uploaded Gaussian of floats. @param {number} shDegree */
export function floatWords(shDegree) {
  return 12 + 3 * (shDegree + 1) ** 2;
}

/** Room for `count` Gaussians, in whole texels. @param {number} count @param {number} wordsEach */
export function roomFor(count, wordsEach) {
  return new Uint32Array(4 * Math.ceil((count * wordsEach) / 4));
}

/** An entry has its layer and move above the 24 bits of its slot; a stream has at most 2^24 slots. */
const SLOT_SKIP_MAP = 0xffffff;

/**
 * Words for the renderer's textures; see renderer/splatrenderer.js.
 * @typedef {object} Words
 * @property {number} frame from which it shows; -1: it shows at once, without motion
 * @property {Uint32Array} lattice @property {Uint32Array} floats
 * @property {Uint32Array} leaving slots whose Gaussians fade out, then zeros, in whole texels
 */

/**
 * Updates that the renderer has not received yet. Memory is bounded even if the renderer stops asking:
 * once there are more entries than slots, only the newest entry of each slot is kept.
 */
export class PendingUpdates {
  /** @type {Words[]} */
  updates = [];
  numEntries = 0;

  /** @param {number} numSlots @param {number} shDegree */
  constructor(numSlots, shDegree) {
    /** @type {number} */ this.numSlots = numSlots;
    /** @type {number} */ this.latticeWords = latticeWords(shDegree);
    /** @type {number} */ this.floatWords = floatWords(shDegree);
  }

  /**
   * @param {Words} words are kept, not copied
   * @returns {boolean} false if all pending updates were merged into one
   */
  add({ frame, lattice, floats, leaving }) {
    if (lattice.length + floats.length + leaving.length === 0) return true;
    this.updates.push({ frame, lattice, floats, leaving });
    this.numEntries += this.#countLattice(lattice) + this.#countFloats(floats);
    const isMuch = this.numEntries > this.numSlots;
    if (isMuch) this.#merge();
    return !isMuch;
  }

  /** Removes and returns all pending updates, oldest first. @returns {Words[]} */
  take() {
    const { updates } = this;
    this.clear();
    return updates;
  }

  clear() {
    this.updates = [];
    this.numEntries = 0;
  }

  /** @param {Uint32Array} words */
  #countLattice(words) {
    return Math.floor(words.length / this.latticeWords);
  }

  /** @param {Uint32Array} words */
  #countFloats(words) {
    return Math.floor(words.length / this.floatWords);
  }

  /** Merges all updates into one that has only the newest entry of each slot. */
  #merge() {
    const isTaken = new Uint8Array(this.numSlots);
    const lattice = new Newest(isTaken, this.numEntries, this.latticeWords, 3);
    const floats = new Newest(isTaken, this.numEntries, this.floatWords, 0);
    for (const update of this.updates.reverse()) {
      // The renderer writes the floats of an update after its lattice.
      floats.addBackwards(update.floats);
      lattice.addBackwards(update.lattice);
    }
    const leaving = new Uint32Array();
    this.updates = [{ frame: -1, lattice: lattice.words, floats: floats.words, leaving }];
    this.numEntries = lattice.count + floats.count;
  }
}

/** Collects one entry per slot, the first that is added; entries are added newest first. */
class Newest {
  count = 0;

  /**
   * @param {Uint8Array} isTaken whether each slot has its entry; is written
   * @param {number} most maximum number of entries @param {number} wordsEach
   * @param {number} slotWord the word of an entry that has its slot
   */
  constructor(isTaken, most, wordsEach, slotWord) {
    /** @type {Uint8Array} */ this.isTaken = isTaken;
    /** @type {Uint32Array} */ this.room = new Uint32Array(most * wordsEach);
    /** @type {number} */ this.wordsEach = wordsEach;
    /** @type {number} */ this.slotWord = slotWord;
  }

  /** Adds entries, the last one first. @param {Uint32Array} words */
  addBackwards(words) {
    const { isTaken, room, wordsEach, slotWord } = this;
    for (let i = Math.floor(words.length / wordsEach) - 1; i >= 0; i--) {
      const from = i * wordsEach;
      const slot = words[from + slotWord] & SLOT_SKIP_MAP;
      if (isTaken[slot]) continue;
      isTaken[slot] = 1;
      const to = this.count * wordsEach;
      for (let n = 0; n < wordsEach; n++) room[to + n] = words[from + n];
      this.count++;
    }
  }

  get words() {
    const words = roomFor(this.count, this.wordsEach);
    words.set(this.room.subarray(0, this.count * this.wordsEach));
    return words;
  }
}
