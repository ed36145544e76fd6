/** Reads bytes from outside, and says what is wrong with them. */

/** The bytes break a rule of codec/FORMAT.md, or this reader does not know their meaning. */
export class FormatError extends Error {
  /** @param {"corrupt" | "unsupported"} kind @param {string} message */
  constructor(kind, message) {
    super(message);
    /** @type {string} */ this.name = "FormatError";
    this.kind = kind;
  }
}

/** @param {string} message */
export function corrupt(message) {
  return new FormatError("corrupt", message);
}

/** @param {string} message */
export function unsupported(message) {
  return new FormatError("unsupported", message);
}

/** Whether bytes are equal to a text of single bytes. @param {Uint8Array} bytes @param {string} magic */
export function isMagic(bytes, magic) {
  return String.fromCharCode(...bytes) === magic;
}

/**
 * The values of a layout in the notation of Python's struct: bytes for `s`, otherwise numbers.
 * @template {string} Format
 * @typedef {Format extends `<${infer Codes}` ? Unpacked<Codes>
 *   : Format extends `${4 | 32}s${infer Rest}` ? [Uint8Array, ...Unpacked<Rest>]
 *   : Format extends "5I" ? [number, number, number, number, number]
 *   : Format extends `${string}${infer Rest}` ? [number, ...Unpacked<Rest>] : []} Unpacked
 */

/** Reads little-endian numbers one after another. Throws a FormatError at the end of the bytes. */
export class ByteReader {
  at = 0;

  /** @param {Uint8Array} bytes @param {string} what named in errors */
  constructor(bytes, what) {
    /** @type {Uint8Array} */ this.bytes = bytes;
    /** @type {string} */ this.what = what;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  get left() {
    return this.bytes.length - this.at;
  }

  /** The next `count` bytes, as a view. @param {number} count */
  take(count) {
    if (count > this.left) {
      throw corrupt(
        `${this.what}: ends at byte ${this.bytes.length}, ${count - this.left} bytes too early`,
      );
    }
    this.at += count;
    return this.bytes.subarray(this.at - count, this.at);
  }

  u8() {
    return this.take(1)[0];
  }

  u16() {
    this.take(2);
    return this.view.getUint16(this.at - 2, true);
  }

  u32() {
    this.take(4);
    return this.view.getUint32(this.at - 4, true);
  }

  /** @template {string} Format @param {Format} format */
  unpack(format) {
    const values = /** @type {(number | bigint | Uint8Array)[]} */ ([]);
    for (const [, count, code] of format.matchAll(/(\d*)([BHIifQs])/g)) {
      if (code === "s") values.push(this.take(Number(count)));
      else for (let n = Number(count || 1); n > 0; n--) values.push(this.#number(code));
    }
    return /** @type {Unpacked<Format>} */ (values);
  }

  /** @param {string} code */
  #number(code) {
    if (code === "B") return this.u8();
    if (code === "H") return this.u16();
    const low = this.u32();
    if (code === "I") return low;
    if (code === "i") return low | 0;
    if (code === "f") return this.view.getFloat32(this.at - 4, true);
    // Values above 2^53 are inexact, but exceed every bound of the format anyway.
    return this.u32() * 2 ** 32 + low;
  }

  /** A copy of the next `count` f32. @param {number} count */
  f32s(count) {
    return new Float32Array(this.#copied(count));
  }

  /** @param {number} count */
  i32s(count) {
    return new Int32Array(this.#copied(count));
  }

  /** @param {number} count */
  u32s(count) {
    return new Uint32Array(this.#copied(count));
  }

  /**
   * A copy of the next 4 * count bytes, because typed arrays need alignment. Every machine that runs a
   * browser is little-endian, like the stream.
   * @param {number} count
   */
  #copied(count) {
    const { buffer, byteOffset, byteLength } = this.take(4 * count);
    return /** @type {ArrayBuffer} */ (buffer).slice(byteOffset, byteOffset + byteLength);
  }

  /** Throws unless all bytes have been read. */
  finish() {
    if (this.left > 0) throw corrupt(`${this.what}: ${this.left} bytes too long`);
  }
}

/** Reads a string of bits, the lowest bit of each byte first (FORMAT.md, section 1). */
export class BitReader {
  at = 0;

  /**
   * @param {Uint8Array} bytes
   * @param {number} numBits number of used bits; `bytes` must have exactly that size, padded with zero bits
   * @param {string} what named in errors
   */
  constructor(bytes, numBits, what) {
    if (bytes.length !== Math.ceil(numBits / 8))
      throw corrupt(`${what}: ${bytes.length} bytes of low bits for ${numBits} bits`);
    if (numBits % 8 !== 0 && bytes[bytes.length - 1] >> numBits % 8 !== 0)
      throw corrupt(`${what}: a bit is set after the last low bit`);
    /** @type {Uint8Array} */ this.bytes = bytes;
  }

  /** The next bits as a number, lowest first. @param {number} width 0 .. 30 */
  take(width) {
    let value = 0;
    let got = 0;
    while (got < width) {
      const shift = this.at & 7;
      const count = Math.min(8 - shift, width - got);
      value |= ((this.bytes[this.at >> 3] >> shift) & ((1 << count) - 1)) << got;
      got += count;
      this.at += count;
    }
    return value;
  }
}
