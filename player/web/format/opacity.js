/** @type {Map<number, Float32Array>} */
const tables = new Map();

/**
 * The logit of every opacity level as f32 (FORMAT.md, section 6.6).
 * @param {number} levels 2 .. 256
 */
export function opacityLogits(levels) {
  let table = tables.get(levels);
  if (table === undefined) {
    table = new Float32Array(levels);
    for (let o = 1; o < levels - 1; o++) table[o] = Math.log(o / (levels - 1 - o));
    table[0] = -16;
    table[levels - 1] = 16;
    tables.set(levels, table);
  }
  return table;
}
