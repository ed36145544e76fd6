import { MAX_SOUND_KEYS, MAX_SOURCES, SOUND_PREFIX } from "../constants.js";
import { corrupt } from "../format/bytes/errors.js";
import { field, integer, list, number, text } from "../format/bytes/json.js";
import { inCamera } from "../view/pose.js";

/** Limit of coordinates: nothing is audible farther away, and devices need finite binary32 numbers. */
const FAR_M = 1e6;

/**
 * A sound source of a stream.
 * @typedef {object} SoundSource
 * @property {string} part the part name of its objects, in place of a layer's number
 * @property {number} channels
 * @property {number[][]} keys time in seconds and place in metres; empty for sound without a place
 */

/**
 * The sources that a manifest's `sound` describes. Throws a FormatError.
 * @param {unknown} value
 * @returns {SoundSource[]}
 */
export function readSources(value) {
  const sources = list(value, 0, MAX_SOURCES, "sound").map(readSource);
  if (new Set(sources.map(({ part }) => part)).size !== sources.length)
    throw corrupt("manifest: two sources of sound have the same name");
  return sources;
}

/** @param {unknown} value @returns {SoundSource} */
function readSource(value) {
  const name = text(field(value, "name"), "name");
  if (!/^[a-z0-9]{1,32}$/.test(name)) throw corrupt("manifest: a source of sound has no such name");
  const keys = list(field(value, "keys"), 0, MAX_SOUND_KEYS, "keys").map((key) =>
    list(key, 4, 4, "a place of a sound").map((item) => number(item, "keys")),
  );
  if (keys.some(([timeS], n) => n > 0 && timeS <= keys[n - 1][0]))
    throw corrupt(`manifest: the places of sound ${name} are not in order of time`);
  const channels = integer(field(value, "channels"), 1, keys.length > 0 ? 1 : 2, "channels");
  return { part: SOUND_PREFIX + name, channels, keys };
}

/**
 * The place of a source with keys.
 * @param {number[][]} keys
 * @param {number} timeS
 * @returns {import("../view/vectors.js").Vector}
 */
export function placeAt(keys, timeS) {
  const after = keys.findIndex(([keyS]) => keyS > timeS);
  if (after <= 0) return (after === 0 ? keys[0] : keys[keys.length - 1]).slice(1);
  const [from, to] = [keys[after - 1], keys[after]];
  const share = (timeS - from[0]) / (to[0] - from[0]);
  return [1, 2, 3].map((axis) => from[axis] + share * (to[axis] - from[axis]));
}

/**
 * The place of a source with keys relative to a listener facing -z with y up, metres; always finite.
 * @param {number[][]} keys
 * @param {number} timeS
 * @param {number[]} w2c (4, 4) world to camera
 */
export function heardAt(keys, timeS, w2c) {
  const [right, down, forward] = inCamera(w2c, placeAt(keys, timeS));
  return [right, -down, -forward].map((at) => Math.max(-FAR_M, Math.min(FAR_M, at)) || 0);
}
