import { corrupt } from "./errors.js";

/** Reads a string of bits, the lowest bit of each byte first (FORMAT.md, section 1). */
export class BitReader {
  /**
   * @param {Uint8Array} bytes
   * @param {number} numBits number of used bits; `bytes` must have exactly that size, padded with zero bits
   * @param {string} what named in errors
   */
  constructor(bytes, numBits, what) {
    if (bytes.length !== Math.ceil(numBits / 8)) {
      throw corrupt(`${what}: ${bytes.length} bytes of low bits for ${numBits} bits`);
    }
    if (numBits % 8 !== 0 && bytes[bytes.length - 1] >> numBits % 8 !== 0) {
      throw corrupt(`${what}: a bit is set after the last low bit`);
    }
    this.bytes = bytes;
    this.at = 0;
  }

  /**
   * The next bits as a number, lowest first.
   * @param {number} width 0 .. 30
   */
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
