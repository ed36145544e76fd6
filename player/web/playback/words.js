/** The size of uploaded Gaussians, which workers write and the graphics device reads, in words of 32 bits. */

/** Words of an uploaded Gaussian on the lattice. @param {number} shDegree */
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
