/** Reads values of manifest.json with the types of the format. All functions throw a FormatError. */

import { MAX_TEXT_CHARS } from "../constants.js";
import { corrupt } from "./bytes.js";

/** The value of a required key. @param {unknown} value @param {string} key @returns {unknown} */
export function field(value, key) {
  if (typeof value !== "object" || value === null || Array.isArray(value))
    throw corrupt(`manifest: ${key} is not in a JSON object`);
  if (!Object.hasOwn(value, key)) throw corrupt(`manifest: ${key} is missing`);
  return /** @type {Record<string, unknown>} */ (value)[key];
}

/** @param {unknown} value @param {string} what */
export function number(value, what) {
  if (typeof value !== "number" || !Number.isFinite(value))
    throw corrupt(`manifest: ${what} is not a number`);
  return value;
}

/**
 * Accepts 3.0 as well as 3, because JavaScript cannot distinguish them; the format allows only the latter.
 * @param {unknown} value @param {number} least @param {number} most @param {string} what
 */
export function integer(value, least, most, what) {
  if (typeof value !== "number" || !Number.isInteger(value) || value < least || value > most)
    throw corrupt(`manifest: ${what} is not an integer from ${least} to ${most}`);
  return value;
}

/** @param {unknown} value @param {string} what */
export function text(value, what) {
  if (typeof value !== "string" || [...value].length > MAX_TEXT_CHARS || !isUnicode(value))
    throw corrupt(`manifest: ${what} is not a text of at most ${MAX_TEXT_CHARS} characters`);
  return value;
}

/** Whether a text has no lone surrogate. @param {string} value */
function isUnicode(value) {
  return !/\p{Surrogate}/u.test(value);
}

/** @param {unknown} value @param {string} what */
export function boolean(value, what) {
  if (typeof value !== "boolean") throw corrupt(`manifest: ${what} is not true or false`);
  return value;
}

/** @param {unknown} value @param {number} least @param {number} most @param {string} what @returns {unknown[]} */
export function list(value, least, most, what) {
  if (!Array.isArray(value) || value.length < least || value.length > most)
    throw corrupt(`manifest: ${what} is not a list of ${least} .. ${most} items`);
  return value;
}
