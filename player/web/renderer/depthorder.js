/** Start of a Gaussian that no frame shows. */
export const NEVER = 2 ** 31 - 1;

const DIGIT_BITS = 11;
const NUM_VALUES = 1 << DIGIT_BITS;

/** Which Gaussians show in a frame, farthest first (player/render/order.py, sort.py). */
export class DepthOrder {
  /** @param {number} numSlots */
  constructor(numSlots) {
    this.means = new Float32Array(3 * numSlots);
    this.starts = new Int32Array(numSlots).fill(NEVER);
    this.depths = new Float32Array(numSlots);
    this.keys = [new Uint32Array(this.depths.buffer), new Uint32Array(numSlots)];
    this.slots = [new Uint32Array(numSlots), new Uint32Array(numSlots)];
    this.counts = new Uint32Array(3 * NUM_VALUES);
  }

  /**
   * Replaces what some slots hold.
   * @param {Uint32Array} slots
   * @param {Float32Array} means (N, 3) metres
   * @param {Int32Array} starts (N) the first frame that shows it, or NEVER
   */
  put(slots, means, starts) {
    for (let i = 0; i < slots.length; i++) {
      const slot = slots[i];
      this.means[3 * slot] = means[3 * i];
      this.means[3 * slot + 1] = means[3 * i + 1];
      this.means[3 * slot + 2] = means[3 * i + 2];
      this.starts[slot] = starts[i];
    }
  }

  /**
   * The slots to draw, a copy; in two bytes each where they fit.
   * @param {number} frame
   * @param {number[]} w2c (4, 4) world to camera, metres
   * @param {number} nearM
   */
  farFirst(frame, w2c, nearM) {
    const { means, starts, depths } = this;
    const slots = this.slots[0];
    const [a, b, c, d] = w2c.slice(8, 12);
    let found = 0;
    // The last slot first: of equally far ones the first is in front, as the CPU renderer has them.
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
    return starts.length <= 2 ** 16 ? new Uint16Array(order) : order.slice();
  }

  /**
   * A stable radix sort of the first keys, by falling depth: the bits of positive floats grow with
   * their value. The result is in slots[1].
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
