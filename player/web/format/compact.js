/** Profile compact of version 1 (FORMAT.md, section 6). */

import { BitReader } from "./bytes/bitreader.js";
import { ByteReader } from "./bytes/bytereader.js";
import { corrupt } from "./bytes/errors.js";
import { emptyGaussians, readGaussians } from "./gaussians.js";
import { opacityLogits } from "./opacity.js";

const { fround, max, sqrt } = Math;

const HEAD_BYTES = 48;
const MAX_GAP_BITS = 60;
/** A position's code has 60 bits: two halves of 30, of which each holds ten bits of every axis. */
const HALF_BITS = 30;
const HALF = 2 ** HALF_BITS;

/**
 * The steps of a chunk, all f32.
 * @typedef {object} Head
 * @property {Float32Array} origin (3) metres
 * @property {number} positionStep metres
 * @property {number} scaleBase
 * @property {number} scaleStep
 * @property {number} rotationStep
 * @property {number} colourBase
 * @property {number} colourStep
 * @property {number} opacityLevels
 * @property {number} rotationHalf
 */

/**
 * @param {ByteReader} body
 * @param {number} count Gaussians, escapes included
 * @param {number} k coefficients
 */
export function readCompact(body, count, k) {
  if (body.left < HEAD_BYTES) throw corrupt("chunk: too short for the head of compact");
  const head = readHead(body);
  const escapes = body.u32();
  const lowBitBytes = body.u32();
  if (escapes > count) throw corrupt(`chunk: ${escapes} escapes for ${count} Gaussians`);
  const n = count - escapes;
  const expected = (8 + 3 * k) * n + lowBitBytes + 4 * (11 + 3 * k) * escapes;
  if (body.left !== expected) {
    throw corrupt(`chunk: ${body.left} bytes follow the head, but the head says ${expected}`);
  }
  const planes = Array.from({ length: 8 + 3 * k }, () => body.take(n));
  const lowBits = body.take(lowBitBytes);
  const tail = readGaussians(body, escapes, k);
  const made = emptyGaussians(count, k);
  fillMeans(made.means, planes[0], lowBits, head);
  fillScales(made.logScales, planes, head);
  fillQuats(made.quats, planes, head);
  fillOpacities(made.logitOpacities, planes[7], head);
  fillColours(made.sh, planes, head, k);
  made.means.set(tail.means, 3 * n);
  made.logScales.set(tail.logScales, 3 * n);
  made.quats.set(tail.quats, 4 * n);
  made.logitOpacities.set(tail.logitOpacities, n);
  made.sh.set(tail.sh, 3 * k * n);
  return made;
}

/**
 * @param {ByteReader} body
 * @returns {Head}
 */
function readHead(body) {
  const numbers = body.f32s(9);
  if (!numbers.every(Number.isFinite)) throw corrupt("chunk: a step is not finite");
  const [positionStep, scaleBase, scaleStep, rotationStep, colourBase, colourStep] =
    numbers.subarray(3);
  const opacityLevels = body.u16();
  const rotationHalf = body.u16();
  if (opacityLevels < 2 || opacityLevels > 256 || rotationHalf < 1 || rotationHalf > 127) {
    throw corrupt(`chunk: ${opacityLevels} opacity levels, half a turn of ${rotationHalf}`);
  }
  return {
    origin: numbers.subarray(0, 3),
    positionStep,
    scaleBase,
    scaleStep,
    rotationStep,
    colourBase,
    colourStep,
    opacityLevels,
    rotationHalf,
  };
}

/**
 * @param {Float32Array} means
 * @param {Uint8Array} lengths bits of every gap
 * @param {Uint8Array} lowBits
 * @param {Head} head
 */
function fillMeans(means, lengths, lowBits, head) {
  let numBits = 0;
  for (const g of lengths) {
    if (g > MAX_GAP_BITS) throw corrupt(`chunk: a gap of ${g} bits`);
    numBits += max(g - 1, 0);
  }
  const bits = new BitReader(lowBits, numBits, "chunk");
  const { origin, positionStep } = head;
  let high = 0;
  let low = 0;
  for (let i = 0; i < lengths.length; i++) {
    const width = lengths[i] - 1;
    if (width >= HALF_BITS) {
      low += bits.take(HALF_BITS);
      high += 2 ** (width - HALF_BITS) + bits.take(width - HALF_BITS);
    } else if (width >= 0) {
      low += 2 ** width + bits.take(width);
    }
    if (low >= HALF) {
      low -= HALF;
      high += 1;
    }
    if (high >= HALF) throw corrupt("chunk: a position has more than 60 bits");
    for (let axis = 0; axis < 3; axis++) {
      const q = everyThird(low >> axis) | (everyThird(high >> axis) << 10);
      means[3 * i + axis] = fround(fround(q * positionStep) + origin[axis]);
    }
  }
}

/**
 * Bits 0, 3, 6 .. 27 of a number, side by side.
 * @param {number} code
 */
function everyThird(code) {
  let x = code & 0x09249249;
  x = (x | (x >> 2)) & 0x030c30c3;
  x = (x | (x >> 4)) & 0x0300f00f;
  x = (x | (x >> 8)) & 0x030000ff;
  return (x | (x >> 16)) & 0x3ff;
}

/**
 * @param {Float32Array} logScales
 * @param {Uint8Array[]} planes
 * @param {Head} head
 */
function fillScales(logScales, planes, head) {
  const [, a, b, c] = planes;
  const { scaleStep, scaleBase } = head;
  for (let i = 0; i < a.length; i++) {
    let q = a[i];
    logScales[3 * i] = fround(fround(q * scaleStep) + scaleBase);
    q -= b[i];
    logScales[3 * i + 1] = fround(fround(q * scaleStep) + scaleBase);
    q -= c[i];
    logScales[3 * i + 2] = fround(fround(q * scaleStep) + scaleBase);
  }
}

/**
 * @param {Float32Array} quats
 * @param {Uint8Array[]} planes
 * @param {Head} head
 */
function fillQuats(quats, planes, head) {
  for (let i = 0; i < planes[4].length; i++) {
    const x = fround((planes[4][i] - head.rotationHalf) * head.rotationStep);
    const y = fround((planes[5][i] - head.rotationHalf) * head.rotationStep);
    const z = fround((planes[6][i] - head.rotationHalf) * head.rotationStep);
    putQuat(quats, i, x, y, z);
  }
}

/**
 * The quaternion whose x, y, z are given, with w from them.
 * @param {Float32Array} quats
 * @param {number} i
 * @param {number} x
 * @param {number} y
 * @param {number} z
 */
export function putQuat(quats, i, x, y, z) {
  const square = fround(fround(fround(x * x) + fround(y * y)) + fround(z * z));
  quats[4 * i] = sqrt(max(fround(1 - square), 0));
  quats[4 * i + 1] = x;
  quats[4 * i + 2] = y;
  quats[4 * i + 3] = z;
}

/**
 * @param {Float32Array} logitOpacities
 * @param {Uint8Array} levels
 * @param {Head} head
 */
function fillOpacities(logitOpacities, levels, head) {
  const logits = opacityLogits(head.opacityLevels);
  for (let i = 0; i < levels.length; i++) {
    if (levels[i] >= head.opacityLevels) throw corrupt(`chunk: opacity ${levels[i]}`);
    logitOpacities[i] = logits[levels[i]];
  }
}

/**
 * @param {Float32Array} sh
 * @param {Uint8Array[]} planes
 * @param {Head} head
 * @param {number} k coefficients
 */
function fillColours(sh, planes, head, k) {
  const { colourStep, colourBase } = head;
  const n = planes[0].length;
  for (let c = 0; c < k; c++) {
    const [luma, orange, green] = [planes[8 + c], planes[8 + k + c], planes[8 + 2 * k + c]];
    for (let i = 0; i < n; i++) {
      const y =
        c === 0
          ? fround(fround(luma[i] * colourStep) + colourBase)
          : fround((luma[i] - 128) * colourStep);
      const co = fround((orange[i] - 128) * colourStep);
      const cg = fround((green[i] - 128) * colourStep);
      putColour(sh, 3 * (i * k + c), y, co, cg);
    }
  }
}

/**
 * RGB of luma and two differences (FORMAT.md, section 6.7).
 * @param {Float32Array} sh
 * @param {number} at
 * @param {number} y
 * @param {number} co
 * @param {number} cg
 */
export function putColour(sh, at, y, co, cg) {
  const rest = fround(y - cg);
  sh[at] = rest + co;
  sh[at + 1] = y + cg;
  sh[at + 2] = rest - co;
}
