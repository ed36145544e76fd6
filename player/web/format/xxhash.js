/** The lower half of XXH64 with seed 0, in 32-bit halves: BigInt is slower by far. */

/** Primes of XXH64: [high, low]. @type {readonly [number, number][]} */
const [P1, P2, P3, P4, P5] = [
  [0x9e3779b1, 0x85ebca87],
  [0xc2b2ae3d, 0x27d4eb4f],
  [0x165667b1, 0x9e3779f9],
  [0x85ebca77, 0xc2b2ae63],
  [0x27d4eb2f, 0x165667c5],
];

const STRIPE_BYTES = 32;

/** The number that the functions below compute with. */
let hi = 0;
let lo = 0;

/** @param {number} high @param {number} low */
function set(high, low) {
  hi = high;
  lo = low;
}

const { imul } = Math;

/** The upper half of a product of two halves. @param {number} a @param {number} b */
function upper(a, b) {
  const a0 = a & 0xffff;
  const a1 = a >>> 16;
  const b0 = b & 0xffff;
  const b1 = b >>> 16;
  const first = (imul(a1, b0) + (imul(a0, b0) >>> 16)) | 0;
  const second = (imul(a0, b1) + (first & 0xffff)) | 0;
  return (imul(a1, b1) + (first >>> 16) + (second >>> 16)) | 0;
}

/** @param {readonly [number, number]} prime */
function multiply([high, low]) {
  hi = (upper(lo, low) + imul(hi, low) + imul(lo, high)) | 0;
  lo = imul(lo, low);
}

/** @param {number} high @param {number} low */
function add(high, low) {
  const sum = (lo >>> 0) + (low >>> 0);
  hi = (hi + high + (sum > 0xffffffff ? 1 : 0)) | 0;
  lo = sum | 0;
}

/** Rotates to the left by 1 to 31 bits. @param {number} bits */
function rotate(bits) {
  set((hi << bits) | (lo >>> (32 - bits)), (lo << bits) | (hi >>> (32 - bits)));
}

/** @param {number} high @param {number} low of the lane @param {number} inHigh @param {number} inLow */
function round(high, low, inHigh, inLow) {
  set(inHigh, inLow);
  multiply(P2);
  add(high, low);
  rotate(31);
  multiply(P1);
}

/** @param {DataView} view @param {Int32Array} lanes @returns {number} where the stripes end */
function addStripes(view, lanes) {
  const [[high1, low1], [high2, low2]] = [P1, P2];
  const end = view.byteLength - (view.byteLength % STRIPE_BYTES);
  for (let n = 0; n < 8; n += 2) {
    // As in `round`, but with local numbers: nearly all of the time goes here.
    let high = lanes[n];
    let low = lanes[n + 1];
    for (let at = 4 * n; at < end; at += STRIPE_BYTES) {
      const word = view.getInt32(at, true);
      const added = imul(word, low2);
      const sum = (low + added) | 0;
      high += upper(word, low2) + imul(view.getInt32(at + 4, true), low2) + imul(word, high2);
      high = (high + (sum >>> 0 < added >>> 0 ? 1 : 0)) | 0;
      low = (sum << 31) | (high >>> 1);
      high = (high << 31) | (sum >>> 1);
      high = (upper(low, low1) + imul(high, low1) + imul(low, high1)) | 0;
      low = imul(low, low1);
    }
    lanes[n] = high;
    lanes[n + 1] = low;
  }
  return end;
}

/** @param {Int32Array} lanes */
function mergeLanes(lanes) {
  let [high, low] = [0, 0];
  for (const [n, bits] of [1, 7, 12, 18].entries()) {
    set(lanes[2 * n], lanes[2 * n + 1]);
    rotate(bits);
    add(high, low);
    [high, low] = [hi, lo];
  }
  for (let n = 0; n < 8; n += 2) {
    round(0, 0, lanes[n], lanes[n + 1]);
    set(hi ^ high, lo ^ low);
    multiply(P1);
    add(...P4);
    [high, low] = [hi, lo];
  }
}

/** The hash as the checksum of a zstd frame. @param {Uint8Array} data @returns {number} u32 */
export function xxhash(data) {
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  let at = 0;
  if (data.length >= STRIPE_BYTES) {
    // P1 + P2, P2, 0, -P1
    const lanes = Int32Array.of(0x60ea27ee, 0xadc0b5d6, ...P2, 0, 0, 0x61c8864e, 0x7a143579);
    at = addStripes(view, lanes);
    mergeLanes(lanes);
  } else set(...P5);
  add(0, data.length);
  for (; at + 8 <= data.length; at += 8) {
    const [high, low] = [hi, lo];
    round(0, 0, view.getInt32(at + 4, true), view.getInt32(at, true));
    set(hi ^ high, lo ^ low);
    rotate(27);
    multiply(P1);
    add(...P4);
  }
  if (at + 4 <= data.length) {
    const [high, low] = [hi, lo];
    set(0, view.getInt32(at, true));
    multiply(P1);
    set(hi ^ high, lo ^ low);
    rotate(23);
    multiply(P2);
    add(...P3);
    at += 4;
  }
  for (; at < data.length; at++) {
    const [high, low] = [hi, lo];
    set(0, data[at]);
    multiply(P5);
    set(hi ^ high, lo ^ low);
    rotate(11);
    multiply(P1);
  }
  set(hi, lo ^ (hi >>> 1));
  multiply(P2);
  set(hi ^ (hi >>> 29), lo ^ ((hi << 3) | (lo >>> 29)));
  multiply(P3);
  return (lo ^ hi) >>> 0;
}
