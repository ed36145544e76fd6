import { floatWords, latticeWords, roomFor } from "./words.js";

/** An entry has its layer and move above the 24 bits of its slot; a stream has at most 2^24 slots. */
const SLOT_MASK = 0xffffff;

/**
 * Words for the renderer's textures; see renderer/resident.js.
 * @typedef {object} Words
 * @property {number} frame from which it shows; -1: it shows at once, without motion
 * @property {Uint32Array} lattice
 * @property {Uint32Array} floats
 * @property {Uint32Array} leaving slots whose Gaussians fade out, then zeros, in whole texels
 */

/**
 * Updates that the renderer has not received yet. Memory is bounded even if the renderer stops asking:
 * once there are more entries than slots, only the newest entry of each slot is kept.
 */
export class PendingUpdates {
  /**
   * @param {number} numSlots
   * @param {number} shDegree
   */
  constructor(numSlots, shDegree) {
    this.numSlots = numSlots;
    this.latticeWords = latticeWords(shDegree);
    this.floatWords = floatWords(shDegree);
    /** @type {Words[]} */
    this.updates = [];
    this.numEntries = 0;
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
  /**
   * @param {Uint8Array} isTaken whether each slot has its entry; is written
   * @param {number} most maximum number of entries
   * @param {number} wordsEach
   * @param {number} slotWord the word of an entry that has its slot
   */
  constructor(isTaken, most, wordsEach, slotWord) {
    this.isTaken = isTaken;
    this.room = new Uint32Array(most * wordsEach);
    this.wordsEach = wordsEach;
    this.slotWord = slotWord;
    this.count = 0;
  }

  /** Adds entries, the last one first. @param {Uint32Array} words */
  addBackwards(words) {
    const { isTaken, room, wordsEach, slotWord } = this;
    for (let i = Math.floor(words.length / wordsEach) - 1; i >= 0; i--) {
      const from = i * wordsEach;
      const slot = words[from + slotWord] & SLOT_MASK;
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
