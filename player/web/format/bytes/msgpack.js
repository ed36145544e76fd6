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
  if (type === 0xde) size = u16(reader);
  else if (type === 0xdf) size = u32(reader);
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
  const read = READERS.get(type);
  if (read === undefined) throw corrupt(`play: a value is of unknown type 0x${type.toString(16)}`);
  return read(reader);
}

/** @type {Map<number, (reader: import("./bytereader.js").ByteReader) => Uint8Array>} */
const BYTES = new Map([
  [0xc4, (reader) => reader.take(reader.u8())],
  [0xc5, (reader) => reader.take(u16(reader))],
  [0xc6, (reader) => reader.take(u32(reader))],
]);

/** @type {[number, (reader: import("./bytereader.js").ByteReader) => unknown][]} */
const BY_TYPE = [
  ...BYTES,
  [0xc0, () => null],
  [0xc2, () => false],
  [0xc3, () => true],
  // Floats become null: no key of a record has a float value, and JavaScript cannot tell 1.0 from 1.
  [0xca, (reader) => (reader.take(4), null)],
  [0xcb, (reader) => (reader.take(8), null)],
  [0xcc, (reader) => reader.u8()],
  [0xcd, u16],
  [0xce, u32],
  [0xcf, (reader) => Number(view(reader, 8).getBigUint64(0))],
  [0xd0, (reader) => view(reader, 1).getInt8(0)],
  [0xd1, (reader) => view(reader, 2).getInt16(0)],
  [0xd2, (reader) => view(reader, 4).getInt32(0)],
  [0xd3, (reader) => Number(view(reader, 8).getBigInt64(0))],
  [0xd9, (reader) => string(reader, reader.u8())],
  [0xda, (reader) => string(reader, u16(reader))],
  [0xdb, (reader) => string(reader, u32(reader))],
  [0xdc, (reader) => array(reader, u16(reader))],
  [0xdd, (reader) => array(reader, u32(reader))],
];
const READERS = new Map(BY_TYPE);

/**
 * A view of the next bytes; msgpack is big-endian.
 * @param {import("./bytereader.js").ByteReader} reader
 * @param {number} size
 */
function view(reader, size) {
  const bytes = reader.take(size);
  return new DataView(bytes.buffer, bytes.byteOffset, size);
}

/** @param {import("./bytereader.js").ByteReader} reader */
function u16(reader) {
  return view(reader, 2).getUint16(0);
}

/** @param {import("./bytereader.js").ByteReader} reader */
function u32(reader) {
  return view(reader, 4).getUint32(0);
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
    const read = BYTES.get(reader.u8());
    if (read === undefined) throw corrupt("play: a list item is not bytes");
    items.push(read(reader));
  }
  return items;
}
