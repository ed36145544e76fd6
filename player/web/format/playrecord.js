/** The records of a /play response (FORMAT.md, section 12). */

import { MAX_LAYERS, MAX_MESSAGE_CHARS, MAX_RECORD_BYTES, PACKETS_KEY } from "../constants.js";
import { ByteReader } from "./bytes/bytereader.js";
import { corrupt } from "./bytes/errors.js";
import { readMap } from "./bytes/msgpack.js";

const INT32_END = 2 ** 31;

/** @typedef {import("../constants.js").PlayRecord} PlayRecord */

/**
 * Decodes the record in `body`, given without its length prefix. Throws a FormatError.
 * @param {Uint8Array} body
 * @returns {PlayRecord}
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
        manifest: bytes(map.get("manifest"), "manifest"),
      };
    case "slice":
      return slice(map);
    case "snapshot": {
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

/**
 * @param {Map<string, unknown>} map
 * @returns {import("../constants.js").SliceRecord}
 */
function slice(map) {
  const found = map.get("mask");
  const mask = found instanceof Uint8Array ? found : null;
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
  if (first === 0 && mask === null)
    throw corrupt(`play: the slice born at ${birth} has no valid mask`);
  if (first > 0 && packets.length === 0)
    throw corrupt(`play: a record has no part of the slice born at ${birth}`);
  return {
    kind: "slice",
    birth: /** @type {number} */ (birth),
    firstLayer: first,
    packets,
    mask: first > 0 ? null : mask,
  };
}

/**
 * @param {Map<string, unknown>} map
 * @param {string} key
 */
function count(map, key) {
  const found = map.get(key);
  if (typeof found !== "number" || !Number.isInteger(found) || found < 0 || found >= INT32_END) {
    throw corrupt(`play: ${key} is not a count`);
  }
  return found;
}

/**
 * @param {unknown} found
 * @param {string} key
 */
function bytes(found, key) {
  if (!(found instanceof Uint8Array)) throw corrupt(`play: ${key} is not bytes`);
  return found;
}

/**
 * @param {Map<string, unknown>} map
 * @param {number} least
 */
function packetsOf(map, least) {
  const found = map.get(PACKETS_KEY);
  if (!Array.isArray(found) || found.length < least || found.length > MAX_LAYERS) {
    throw corrupt("play: a record has no valid list of packets");
  }
  return found.map((packet) => bytes(packet, "a packet"));
}

/**
 * @param {Map<string, unknown>} map
 * @param {Uint8Array[]} packets
 */
function firstLayer(map, packets) {
  const first = count(map, "first");
  if (first + packets.length > MAX_LAYERS) {
    throw corrupt(`play: ${packets.length} packets starting at layer ${first} are too many`);
  }
  return first;
}

/** Parses a response's bytes, in pieces of any size, into records. Buffers at most one partial record. */
export class RecordParser {
  constructor() {
    /** @type {Uint8Array[]} */
    this.pieces = [];
    this.pendingBytes = 0;
    /** @type {number | null} bytes of the record that comes, once they are known */
    this.length = null;
  }

  /**
   * The records that `data` completes, in order. After an exception, the parser must not be used further.
   * @param {Uint8Array} data
   * @returns {PlayRecord[]}
   */
  feed(data) {
    this.pieces.push(data);
    this.pendingBytes += data.length;
    const records = [];
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
