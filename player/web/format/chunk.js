/** Chunks of version 1: one layer of one slice, by itself (FORMAT.md, sections 4, 5 and 11). */

import { ByteReader } from "./bytes/bytereader.js";
import { readCompact } from "./compact.js";
import { corrupt, unsupported } from "./bytes/errors.js";
import { checkGaussians, emptyGaussians, numCoefficients, readGaussians } from "./gaussians.js";
import { opacityLogits } from "./opacity.js";

export const MAX_COUNT = 1 << 20;
const MAX_BODY_BYTES = 248_512_560;
const HAS_STARTS = 1;

export const PROFILES = /** @type {const} */ (["raw", "paper", "compact"]);

/**
 * @typedef {object} Chunk
 * @property {number} birth
 * @property {number} layer
 * @property {typeof PROFILES[number]} profile
 * @property {number} shDegree
 * @property {number} count
 * @property {import("./gaussians.js").Gaussians} gaussians
 * @property {Uint8Array} startOffsets (count) frames after the birth
 */

/**
 * Decodes a chunk. Throws a FormatError, whatever the bytes.
 * @param {Uint8Array} bytes
 * @returns {Chunk}
 */
export function decodeChunk(bytes) {
  const reader = new ByteReader(bytes, "chunk");
  if (reader.magic() !== "SWGC") throw corrupt("chunk: does not begin with SWGC");
  const version = reader.u8();
  const mode = reader.u8();
  const profile = PROFILES[reader.u8()];
  const flags = reader.u8();
  const birth = reader.i32();
  const count = reader.u32();
  const layer = reader.u8();
  const shDegree = reader.u8();
  const reserved = reader.u16();
  const bodyBytes = reader.u32();
  if (version !== 1) throw unsupported(`chunk: unknown version ${version}`);
  if (mode !== 0 || profile === undefined || flags & ~HAS_STARTS || shDegree > 3 || reserved) {
    throw unsupported("chunk: unknown mode, profile, flag or SH degree");
  }
  if (count > MAX_COUNT)
    throw corrupt(`chunk: ${count} Gaussians, but at most ${MAX_COUNT} are allowed`);
  if (bodyBytes > MAX_BODY_BYTES || bodyBytes !== reader.left) {
    throw corrupt(`chunk: the body has ${reader.left} bytes, but the header says ${bodyBytes}`);
  }
  const offsetBytes = flags & HAS_STARTS ? count : 0;
  if (offsetBytes > bodyBytes) throw corrupt("chunk: too short for its start offsets");
  const body = new ByteReader(reader.take(bodyBytes - offsetBytes), "chunk");
  const startOffsets = offsetBytes ? reader.take(count).slice() : new Uint8Array(count);
  const gaussians = READERS[profile](body, count, numCoefficients(shDegree));
  body.finish();
  checkGaussians(gaussians, "chunk");
  return { birth, layer, profile, shDegree, count, gaussians, startOffsets };
}

const READERS = { raw: readRaw, paper: readPaper, compact: readCompact };

/**
 * @param {ByteReader} body
 * @param {number} count
 * @param {number} k coefficients
 */
function readRaw(body, count, k) {
  expectLength(body, 4 * count * (11 + 3 * k));
  return readGaussians(body, count, k);
}

/**
 * @param {ByteReader} body
 * @param {number} count
 * @param {number} k coefficients
 */
function readPaper(body, count, k) {
  expectLength(body, count * (17 + 12 * k));
  const made = emptyGaussians(count, k);
  for (const values of [made.means, made.logScales]) {
    for (let i = 0; i < values.length; i++) values[i] = halfToNumber(body.u16());
  }
  const turns = body.take(4 * count);
  for (let i = 0; i < turns.length; i++) made.quats[i] = (turns[i] - 128) / 128;
  const levels = body.take(count);
  const logits = opacityLogits(256);
  for (let i = 0; i < count; i++) made.logitOpacities[i] = logits[levels[i]];
  made.sh = body.f32s(3 * k * count);
  return made;
}

/**
 * Refuses a wrong length before anything is allocated.
 * @param {ByteReader} body
 * @param {number} numBytes
 */
function expectLength(body, numBytes) {
  if (body.left !== numBytes) {
    throw corrupt(`chunk: the body has ${body.left} bytes, but its count says ${numBytes}`);
  }
}

/**
 * The number of an IEEE 754 binary16.
 * @param {number} bits
 */
function halfToNumber(bits) {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (exponent ? (1024 + fraction) * 2 ** (exponent - 25) : fraction * 2 ** -24);
}
