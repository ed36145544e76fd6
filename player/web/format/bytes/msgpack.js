/** Reads the small part of msgpack that play records use. */

import { MAX_ITEMS, MAX_KEYS, MAX_TEXT_BYTES } from "../../constants.js";
import { corrupt } from "./errors.js";

/**
 * Reads one map with texts as keys; no value is a map, and arrays contain bytes only. Bytes are returned as
 * views. Throws a FormatError.
 * @param {import("./bytereader.js").ByteReader} reader
 * @returns {Map<string, unknown>}
 */
export function readMap(reader) {
  const type = reader.u8();
  let size = type & 15;
  if (type === 0xde) size = number(reader, 2);
  else if (type === 0xdf) size = number(reader, 4);
  else if (type >> 4 !== 8) throw corrupt("play: a record is not a map");
  if (size > MAX_KEYS) throw corrupt(`play: a record of ${size} keys is too long`);
  /** @type {Map<string, unknown>} */
  const map = new Map();
  for (let i = 0; i < size; i++) {
    const key = readValue(reader);
    if (typeof key !== "string" && !(key instanceof Uint8Array)) {
      throw corrupt("play: a key is neither text nor bytes");
    }
    const value = readValue(reader);
    if (typeof key === "string") map.set(key, value);
  }
  return map;
}

/**
 * @param {import("./bytereader.js").ByteReader} reader
 * @returns {unknown}
 */
function readValue(reader) {
  const type = reader.u8();
  if (type < 0x80) return type;
  if (type >= 0xe0) return type - 256;
  if (type >= 0xa0 && type < 0xc0) return string(reader, type & 31);
  if (type >= 0x90 && type < 0xa0) return array(reader, type & 15);
  if (type === 0xc0) return null;
  if (type === 0xc2 || type === 0xc3) return type === 0xc3;
  if (type >= 0xc4 && type <= 0xc6) return bytes(reader, type);
  // Floats become null: no key of a record has a float value, and JavaScript cannot tell 1.0 from 1.
  if (type === 0xca || type === 0xcb) return (reader.take(type === 0xca ? 4 : 8), null);
  if (type >= 0xcc && type <= 0xd3) return number(reader, 1 << (type & 3), type >= 0xd0);
  if (type >= 0xd9 && type <= 0xdb) return string(reader, number(reader, 1 << (type - 0xd9)));
  if (type === 0xdc || type === 0xdd) return array(reader, number(reader, type === 0xdc ? 2 : 4));
  throw corrupt(`play: a value is of unknown type 0x${type.toString(16)}`);
}

/** @param {import("./bytereader.js").ByteReader} reader @param {number} type 0xc4 to 0xc6 */
function bytes(reader, type) {
  return reader.take(number(reader, 1 << (type - 0xc4)));
}

/**
 * A number of so many bytes; msgpack is big-endian.
 * @param {import("./bytereader.js").ByteReader} reader
 * @param {number} size
 * @param {boolean} isSigned
 */
function number(reader, size, isSigned = false) {
  const bytes = reader.take(size);
  const first = isSigned ? (bytes[0] << 24) >> 24 : bytes[0];
  return bytes.subarray(1).reduce((value, byte) => 256 * value + byte, first);
}

/**
 * @param {import("./bytereader.js").ByteReader} reader
 * @param {number} size
 */
function string(reader, size) {
  if (size > MAX_TEXT_BYTES) throw corrupt(`play: a text of ${size} bytes is too long`);
  try {
    return new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(reader.take(size));
  } catch (error) {
    if (error instanceof TypeError) throw corrupt("play: a text is not UTF-8");
    throw error;
  }
}

/**
 * @param {import("./bytereader.js").ByteReader} reader
 * @param {number} size
 */
function array(reader, size) {
  if (size > MAX_ITEMS) throw corrupt(`play: a list of ${size} items is too long`);
  const items = [];
  for (let i = 0; i < size; i++) {
    // The type is checked before the item is read, because nested lists could have any depth.
    const type = reader.u8();
    if (type < 0xc4 || type > 0xc6) throw corrupt("play: a list item is not bytes");
    items.push(bytes(reader, type));
  }
  return items;
}
