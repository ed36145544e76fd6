/**
 * The Gaussians that show, slot by slot, unpacked from what the play worker packs, and their changes since
 * the last call.
 */

import { ON_LATTICE, SH_C0 } from "../constants.js";
import { gaussiansOf } from "../format/dequantise.js";
import { numCoefficients } from "../format/gaussians.js";
import { Slots } from "../format/slots/slots.js";
import { floatWords, latticeWords, NEVER } from "../playback/depthorder.js";

/**
 * Gaussians and the slots that they are put into.
 * @typedef {object} Placed
 * @property {Uint32Array} slots (N)
 * @property {import("../format/gaussians.js").Gaussians} gaussians N
 */

/**
 * Unpacks Gaussians on the lattice; bit for bit equal to the decoder's output.
 * @param {Uint32Array} words `latticeWords` each @param {number} shDegree
 * @param {import("../format/gaussians.js").Lattice[]} lattices of each layer @returns {Placed[]} by layer
 */
function expandLattice(words, shDegree, lattices) {
  const each = latticeWords(shDegree);
  const numAttributes = 7 + 3 * numCoefficients(shDegree);
  const count = Math.floor(words.length / each);
  const bytes = new Uint8Array(words.buffer, words.byteOffset, words.byteLength);
  /** @type {number[][]} start of each Gaussian's words, by layer */
  const places = lattices.map(() => []);
  for (let at = 0; at < count * each; at += each) places[(words[at + 3] >>> 24) & 15].push(at);
  return places.map((found, layer) => {
    const rows = new Slots(found.length, numAttributes, ON_LATTICE);
    const slots = new Uint32Array(found.length);
    for (const [row, at] of found.entries()) {
      for (let axis = 0; axis < 3; axis++) {
        rows.positions[3 * row + axis] = words[at + axis] >> 8;
        rows.attributes[numAttributes * row + axis] = words[at + axis] & 0xff;
      }
      const from = 4 * (at + 4);
      const others = bytes.subarray(from, from + numAttributes - 3);
      rows.attributes.set(others, numAttributes * row + 3);
      slots[row] = words[at + 3] & 0xffffff;
    }
    return {
      slots,
      gaussians: gaussiansOf(
        rows,
        slots.map((_, row) => row),
        lattices[layer],
      ),
    };
  });
}

/**
 * Unpacks Gaussians that are floats.
 * @param {Uint32Array} words `floatWords` each @param {number} shDegree @returns {Placed}
 */
function expandFloats(words, shDegree) {
  const each = floatWords(shDegree);
  const count = Math.floor(words.length / each);
  const values = new Float32Array(words.buffer, words.byteOffset, words.length);
  const slots = new Uint32Array(count);
  const rest = 3 * numCoefficients(shDegree);
  const widths = { means: 3, logScales: 3, quats: 4, logitOpacities: 1, sh: rest };
  const gaussians = /** @type {import("../format/gaussians.js").Gaussians} */ (
    Object.fromEntries(
      Object.entries(widths).map(([name, n]) => [name, new Float32Array(n * count)]),
    )
  );
  for (let i = 0; i < count; i++) {
    slots[i] = words[each * i] & 0xffffff;
    let at = each * i + 1;
    for (const [name, width] of Object.entries(widths)) {
      const array = gaussians[/** @type {keyof typeof widths} */ (name)];
      array.set(values.subarray(at, at + width), width * i);
      at += width;
    }
  }
  return { slots, gaussians };
}

/**
 * Gaussians in the form that renderers use: all f32, one array per attribute.
 * @typedef {object} SceneGaussians
 * @property {Float32Array} means (N, 3) metres, world
 * @property {Float32Array} scales (N, 3) standard deviations along the axes, metres
 * @property {Float32Array} quats (N, 4) w, x, y, z; of length 1
 * @property {Float32Array} opacities (N) 0 .. 1; 0 where nothing shows
 * @property {Float32Array} colours (N, 3) display RGB, without the view-dependent part; may lie outside
 *   0 .. 1
 * @property {Float32Array} harmonics (N, K - 1, 3) the other coefficients of the spherical harmonics, RGB
 */

/**
 * The changes since the last call.
 * @typedef {object} SceneChange
 * @property {number} frame the one that shows now
 * @property {Uint32Array} slots (N) the changed ones
 * @property {SceneGaussians} gaussians N, the new Gaussians of these slots
 */

/** @param {number} count @param {number} shDegree @returns {SceneGaussians} */
export function emptyScene(count, shDegree) {
  return {
    means: new Float32Array(3 * count),
    scales: new Float32Array(3 * count),
    quats: new Float32Array(4 * count),
    opacities: new Float32Array(count),
    colours: new Float32Array(3 * count),
    harmonics: new Float32Array(3 * (numCoefficients(shDegree) - 1) * count),
  };
}

/**
 * Copies rows of every array.
 * @param {SceneGaussians} from @param {(i: number) => number} fromRow @param {SceneGaussians} to
 * @param {(i: number) => number} toRow @param {number} count
 */
export function copyRows(from, fromRow, to, toRow, count) {
  const total = to.opacities.length;
  for (const name of /** @type {(keyof SceneGaussians)[]} */ (Object.keys(to))) {
    const [source, target] = [from[name], to[name]];
    const width = total === 0 ? 0 : target.length / total;
    for (let i = 0; i < count; i++) {
      const [a, b] = [width * fromRow(i), width * toRow(i)];
      for (let n = 0; n < width; n++) target[b + n] = source[a + n];
    }
  }
}

/** Collects changes until they are taken. Its size depends only on the number of slots. */
export class Scene {
  /**
   * @param {number} numSlots @param {number} shDegree
   * @param {import("../format/gaussians.js").Lattice[]} lattices of each layer
   */
  constructor(numSlots, shDegree, lattices) {
    /** @type {number} */ this.shDegree = shDegree;
    this.lattices = lattices;
    /** @type {SceneGaussians} */ this.held = emptyScene(numSlots, shDegree);
    /** @type {Int32Array} */ this.starts = new Int32Array(numSlots).fill(NEVER);
    /** Whether each slot's Gaussian has changed since the last `take`. @type {Uint8Array} */
    this.isNew = new Uint8Array(numSlots);
    /** Whether each slot showed a Gaussian at the last `take`. @type {Uint8Array} */
    this.wasShown = new Uint8Array(numSlots);
    /** @type {number | null} */
    this.frame = null;
  }

  /** @param {import("../playback/playback.js").Shown} shown */
  put({ frame, isJoin, updates }) {
    if (isJoin) this.starts.fill(NEVER);
    for (const { lattice, floats, slots, starts } of updates) {
      for (const [i, slot] of slots.entries()) {
        this.starts[slot] = starts[i];
        this.isNew[slot] = 1;
      }
      for (const placed of expandLattice(lattice, this.shDegree, this.lattices)) this.#hold(placed);
      this.#hold(expandFloats(floats, this.shDegree));
    }
    this.frame = frame;
  }

  /** Returns the changes since the last call. @returns {SceneChange} */
  take() {
    const frame = this.frame ?? -1;
    const changed = /** @type {number[]} */ ([]);
    for (let slot = 0; slot < this.starts.length; slot++) {
      const shows = this.starts[slot] <= frame ? 1 : 0;
      if (shows !== this.wasShown[slot] || (shows && this.isNew[slot])) changed.push(slot);
      this.wasShown[slot] = shows;
      // A Gaussian that starts later is found when it begins to show.
      this.isNew[slot] = 0;
    }
    const slots = Uint32Array.from(changed);
    const gaussians = emptyScene(slots.length, this.shDegree);
    copyRows(
      this.held,
      (i) => slots[i],
      gaussians,
      (i) => i,
      slots.length,
    );
    for (let i = 0; i < slots.length; i++) {
      if (!this.wasShown[slots[i]]) gaussians.opacities[i] = 0;
    }
    return { frame, slots, gaussians };
  }

  /** @param {Placed} placed */
  #hold({ slots, gaussians }) {
    const { held } = this;
    const k = numCoefficients(this.shDegree);
    const { means, logScales, quats, logitOpacities, sh } = gaussians;
    for (const [i, slot] of slots.entries()) {
      for (let axis = 0; axis < 3; axis++) {
        held.means[3 * slot + axis] = means[3 * i + axis];
        held.scales[3 * slot + axis] = Math.exp(logScales[3 * i + axis]);
        held.colours[3 * slot + axis] = 0.5 + SH_C0 * sh[3 * k * i + axis];
      }
      const quat = quats.subarray(4 * i, 4 * i + 4);
      const length = Math.hypot(...quat);
      for (let n = 0; n < 4; n++) held.quats[4 * slot + n] = quat[n] / length;
      held.opacities[slot] = 1 / (1 + Math.exp(-logitOpacities[i]));
      held.harmonics.set(sh.subarray(3 * (k * i + 1), 3 * k * (i + 1)), 3 * (k - 1) * slot);
    }
  }
}
