/** Unpacks the Gaussians that the play worker has packed (playback/packing). */

import { gaussiansOf } from "../format/dequantise.js";
import { numCoefficients } from "../format/gaussians.js";
import { ON_LATTICE } from "../constants.js";
import { Slots } from "../format/slots/slots.js";
import { floatWords, latticeWords } from "../playback/words.js";

/**
 * Gaussians and the slots that they are put into.
 * @typedef {object} Placed
 * @property {Uint32Array} slots (N)
 * @property {import("../format/gaussians.js").Gaussians} gaussians N
 */

/**
 * Unpacks Gaussians on the lattice; bit for bit equal to the decoder's output.
 * @param {Uint32Array} words `latticeWords` each
 * @param {number} shDegree
 * @param {import("../format/slots/slotlayout.js").Lattice[]} lattices of each layer
 * @returns {Placed[]} by layer
 */
export function expandLattice(words, shDegree, lattices) {
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
 * @param {Uint32Array} words `floatWords` each
 * @param {number} shDegree
 * @returns {Placed}
 */
export function expandFloats(words, shDegree) {
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
