/** The records of a /play response (FORMAT.md, section 12), and the small part of msgpack that they use. */

import {
  MAX_ITEMS,
  MAX_KEYS,
  MAX_LAYERS,
  MAX_MESSAGE_CHARS,
  MAX_RECORD_BYTES,
  MAX_TEXT_BYTES,
  PACKETS_KEY,
} from "../constants.js";
import { ByteReader, corrupt } from "./bytes.js";

/**
 * Reads one map with texts as keys; no value is a map, and arrays contain bytes only. Bytes are returned as
 * views. Throws a FormatError.
 * @param {import("./bytes.js").ByteReader} reader @returns {Map<string, unknown>}
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
    if (typeof key !== "string" && !(key instanceof Uint8Array))
      throw corrupt("play: a key is neither text nor bytes");
    const value = readValue(reader);
    if (typeof key === "string") map.set(key, value);
  }
  return map;
}

/** @param {import("./bytes.js").ByteReader} reader @returns {unknown} */
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

/** @param {import("./bytes.js").ByteReader} reader @param {number} type 0xc4 to 0xc6 */
function bytes(reader, type) {
  return reader.take(number(reader, 1 << (type - 0xc4)));
}

/**
 * A number of so many bytes; msgpack is big-endian.
 * @param {import("./bytes.js").ByteReader} reader @param {number} size @param {boolean} isSigned
 */
function number(reader, size, isSigned = false) {
  const bytes = reader.take(size);
  const first = isSigned ? (bytes[0] << 24) >> 24 : bytes[0];
  return bytes.subarray(1).reduce((value, byte) => 256 * value + byte, first);
}

/** @param {import("./bytes.js").ByteReader} reader @param {number} size */
function string(reader, size) {
  if (size > MAX_TEXT_BYTES) throw corrupt(`play: a text of ${size} bytes is too long`);
  try {
    return new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(reader.take(size));
  } catch (error) {
    if (error instanceof TypeError) throw corrupt("play: a text is not UTF-8");
    throw error;
  }
}

/** @param {import("./bytes.js").ByteReader} reader @param {number} size */
function array(reader, size) {
  if (size > MAX_ITEMS) throw corrupt(`play: a list of ${size} items is too long`);
  const items = /** @type {Uint8Array[]} */ ([]);
  for (let i = 0; i < size; i++) {
    // The type is checked before the item is read, because nested lists could have any depth.
    const type = reader.u8();
    if (type < 0xc4 || type > 0xc6) throw corrupt("play: a list item is not bytes");
    items.push(bytes(reader, type));
  }
  return items;
}

const INT32_END = 2 ** 31;

/** @typedef {import("../constants.js").PlayRecord} PlayRecord */

/**
 * Decodes the record in `body`, given without its length prefix. Throws a FormatError.
 * @param {Uint8Array} body @returns {PlayRecord}
 */
function decodeRecord(body) {
  const reader = new ByteReader(body, "play");
  const map = readMap(reader);
  reader.finish();
  const kind = map.get("kind");
  switch (kind) {
    case "start":
      return {
        kind,
        fromFrame: count(map, "from"),
        numFrames: count(map, "num_frames"),
        manifest: checkedBytes(map.get("manifest"), "manifest"),
      };
    case "slice":
      return slice(map);
    case "keyframe": {
      const packets = packetsOf(map, 1);
      return { kind, frame: count(map, "frame"), firstLayer: firstLayer(map, packets), packets };
    }
    case "end":
      return { kind, numFrames: count(map, "num_frames") };
    case "error": {
      const message = map.get("message");
      if (typeof message !== "string") throw corrupt("play: an error record has no message");
      return { kind, message: [...message].slice(0, MAX_MESSAGE_CHARS).join("") };
    }
    default:
      throw corrupt("play: a record is of an unknown kind");
  }
}

/** @param {Map<string, unknown>} map @returns {import("../constants.js").SliceRecord} */
function slice(map) {
  const found = map.get("skip_map");
  const skipMap = found instanceof Uint8Array ? found : null;
  const packets = packetsOf(map, 0);
  const birth = map.get("birth");
  if (
    !Number.isInteger(birth) ||
    /** @type {number} */ (birth) < -INT32_END ||
    /** @type {number} */ (birth) >= INT32_END
  ) {
    throw corrupt("play: a slice has no valid birth");
  }
  const first = map.has("first") ? firstLayer(map, packets) : 0;
  if (first === 0 && skipMap === null)
    throw corrupt(`play: the slice born at ${birth} has no valid skip map`);
  if (first > 0 && packets.length === 0)
    throw corrupt(`play: a record has no part of the slice born at ${birth}`);
  return {
    kind: "slice",
    birth: /** @type {number} */ (birth),
    firstLayer: first,
    packets,
    skipMap: first > 0 ? null : skipMap,
  };
}

/** @param {Map<string, unknown>} map @param {string} key */
function count(map, key) {
  const found = map.get(key);
  if (typeof found !== "number" || !Number.isInteger(found) || found < 0 || found >= INT32_END)
    throw corrupt(`play: ${key} is not a count`);
  return found;
}

/** @param {unknown} found @param {string} key */
function checkedBytes(found, key) {
  if (!(found instanceof Uint8Array)) throw corrupt(`play: ${key} is not bytes`);
  return found;
}

/** @param {Map<string, unknown>} map @param {number} least */
function packetsOf(map, least) {
  const found = map.get(PACKETS_KEY);
  if (!Array.isArray(found) || found.length < least || found.length > MAX_LAYERS)
    throw corrupt("play: a record has no valid list of packets");
  return found.map((packet) => checkedBytes(packet, "a packet"));
}

/** @param {Map<string, unknown>} map @param {Uint8Array[]} packets */
function firstLayer(map, packets) {
  const first = count(map, "first");
  if (first + packets.length > MAX_LAYERS)
    throw corrupt(`play: ${packets.length} packets starting at layer ${first} are too many`);
  return first;
}

/** Parses a response's bytes, in pieces of any size, into records. Buffers at most one partial record. */
export class RecordParser {
  /** @type {Uint8Array[]} */
  pieces = [];
  pendingBytes = 0;
  /** @type {number | null} bytes of the record that comes, once they are known */
  length = null;

  /**
   * The records that `data` completes, in order. After an exception, the parser must not be used further.
   * @param {Uint8Array} data @returns {PlayRecord[]}
   */
  feed(data) {
    this.pieces.push(data);
    this.pendingBytes += data.length;
    const records = /** @type {PlayRecord[]} */ ([]);
    while (this.pendingBytes >= (this.length ?? 4)) {
      if (this.length === null) {
        const [a, b, c, d] = this.#take(4);
        this.length = (a | (b << 8) | (c << 16) | (d << 24)) >>> 0;
        if (this.length > MAX_RECORD_BYTES)
          throw corrupt(`play: a record of ${this.length} bytes is too long`);
      } else {
        records.push(decodeRecord(this.#take(this.length)));
        this.length = null;
      }
    }
    return records;
  }

  /** @param {number} size */
  #take(size) {
    const found = new Uint8Array(size);
    for (let at = 0; at < size; ) {
      const piece = this.pieces[0];
      const used = Math.min(piece.length, size - at);
      found.set(piece.subarray(0, used), at);
      at += used;
      if (used === piece.length) this.pieces.shift();
      else this.pieces[0] = piece.subarray(used);
    }
    this.pendingBytes -= size;
    return found;
  }
}
