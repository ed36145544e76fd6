import { ESCAPED, ON_LATTICE } from "../constants.js";
import { gaussiansOf } from "./dequantise.js";
import { numCoefficients } from "./gaussians.js";

/**
 * The Gaussians that show at a decoder's frame, as the PLY of 3D Gaussian Splatting; `swings-stream export`
 * writes the same bytes.
 * @param {import("./slots/slotdecoder.js").SlotDecoder} decoder
 */
export function framePly(decoder) {
  const { layout, frame } = decoder;
  const last = frame ?? 0;
  /** @type {import("./gaussians.js").Gaussians[]} */
  const found = [];
  for (let birth = last - layout.swinSize + 1; birth <= last; birth++) {
    const { lane, rows } = decoder.whole(birth);
    const slots = decoder.lanes[lane];
    for (const [layer, { conditions, starts }] of slots.entries()) {
      const shown = rows[layer].filter(
        (row) => [ON_LATTICE, ESCAPED].includes(conditions[row]) && birth + starts[row] <= last,
      );
      found.push(gaussiansOf(slots[layer], shown, layout.lattices[layer]));
    }
  }
  const numRest = numCoefficients(layout.shDegree) - 1;
  const count = found.reduce((sum, { logitOpacities }) => sum + logitOpacities.length, 0);
  const head = new TextEncoder().encode(header(count, numRest));
  const values = found.map((gaussians) => rowsOf(gaussians, numRest));
  return new Blob([head, ...values]);
}

/** @param {number} count @param {number} numRest coefficients of a colour, without the first */
function header(count, numRest) {
  const numbered = (/** @type {string} */ stem, /** @type {number} */ n) =>
    [...Array(n).keys()].map((i) => `${stem}_${i}`);
  const names = ["x", "y", "z", "nx", "ny", "nz", ...numbered("f_dc", 3)];
  names.push(...numbered("f_rest", 3 * numRest), "opacity");
  names.push(...numbered("scale", 3), ...numbered("rot", 4));
  const properties = names.map((name) => `property float ${name}\n`).join("");
  return `ply\nformat binary_little_endian 1.0\nelement vertex ${count}\n${properties}end_header\n`;
}

/** A row for each Gaussian. @param {import("./gaussians.js").Gaussians} gaussians @param {number} numRest */
function rowsOf({ means, logScales, quats, logitOpacities, sh }, numRest) {
  const width = 17 + 3 * numRest;
  const rows = new Float32Array(width * logitOpacities.length);
  for (let i = 0; i < logitOpacities.length; i++) {
    const at = width * i;
    const dc = 3 * (numRest + 1) * i;
    rows.set(means.subarray(3 * i, 3 * i + 3), at);
    rows.set(sh.subarray(dc, dc + 3), at + 6);
    // Channel after channel in the file.
    for (let n = 0; n < 3 * numRest; n++)
      rows[at + 9 + n] = sh[dc + 3 * (1 + (n % numRest)) + Math.floor(n / numRest)];
    rows[at + width - 8] = logitOpacities[i];
    rows.set(logScales.subarray(3 * i, 3 * i + 3), at + width - 7);
    rows.set(quats.subarray(4 * i, 4 * i + 4), at + width - 4);
  }
  return rows;
}
