/** The packets of changes whose planes are coded (FORMAT.md, section 10.5). They come after the first picture. */

import {
  CENTRE_BITS,
  CHUNK_KINDS,
  CHUNK_MAGIC,
  CODE_BITS,
  CODED,
  CODED_HEAD,
  COUNTS_BYTES,
  LENGTH_BITS,
  LONG,
  MAX_CHUNK_BYTES,
  MAX_EXPANSION,
  MOST_LENGTH,
  MOST_LOW_BITS,
  MOST_ONES,
  NUM_CODES,
  SH_DEGREE_BITS,
} from "../constants.js";
import { ByteReader, corrupt, unsupported } from "./bytes.js";
import { crc32 } from "./objects.js";
import { zstdContent } from "./zstd.js";

const CHECKSUM_BYTES = 4;
const HEAD_BYTES = 12;
const FIRST_PLANE = HEAD_BYTES + COUNTS_BYTES;
/** Bits behind the end that are read as zeros before the end is noticed. */
const SPARE_BYTES = 8;

/** For each code and number of ones, the low bits that follow, and the least value. */
const WIDTHS = new Uint8Array(NUM_CODES * (MOST_ONES + 1));
const LEAST = new Int32Array(WIDTHS.length);
for (let code = 0, at = 0; code < NUM_CODES; code++) {
  for (let ones = 0, least = 0; ones <= MOST_ONES; ones++, at++) {
    const width = (code >> 2) + (ones >> (code & 3));
    WIDTHS[at] = ones < MOST_ONES ? Math.min(width, MOST_LOW_BITS) : MOST_LOW_BITS;
    LEAST[at] = least;
    least += 1 << WIDTHS[at];
  }
}

/** The planes that share a pattern. @param {number} k coefficients */
function groupsOf(k) {
  const colours = Array.from({ length: k }, (_, n) => [9 + n, 9 + k + n, 9 + 2 * k + n]);
  return [[0, 1, 2, 9 + 3 * k], [3, 4, 5], [6, 7, 8], ...colours];
}

/** Reads planes from a bit string. */
class PlaneReader {
  at = 0;
  table = new Uint16Array(1 << MOST_LENGTH);

  /** @param {Uint8Array} body */
  constructor(body) {
    const bytes = new Uint8Array(body.length + SPARE_BYTES);
    bytes.set(body);
    this.view = new DataView(bytes.buffer);
    /** @type {number} */ this.numBits = 8 * body.length;
  }

  /** The next 25 bits at least. */
  peek() {
    if (this.at > this.numBits) throw corrupt("packet: ends inside its planes");
    return this.view.getUint32(this.at >> 3, true) >>> (this.at & 7);
  }

  /** @param {number} count 25 at most */
  take(count) {
    const value = this.peek() & ((1 << count) - 1);
    this.at += count;
    return value;
  }

  number() {
    const length = this.take(CODE_BITS);
    const low = this.take(Math.min(length, 16));
    return low + 65536 * this.take(Math.max(length - 16, 0));
  }

  /** The next value. @param {number} first where the code begins in WIDTHS */
  value(first) {
    const word = this.peek();
    const zeros = (~word & ((1 << MOST_ONES) - 1)) | (1 << MOST_ONES);
    const ones = 31 - Math.clz32(zeros & -zeros);
    const used = Math.min(ones + 1, MOST_ONES);
    const width = WIDTHS[first + ones];
    this.at += used + width;
    return LEAST[first + ones] + ((word >>> used) & ((1 << width) - 1));
  }

  /**
   * Which of a group's planes are not 0, for each Gaussian; gives those that may be.
   * @param {number} numPlanes @param {Uint8Array} patterns
   */
  patterns(numPlanes, patterns) {
    const lengths = Array.from({ length: 1 << numPlanes }, () => this.take(LENGTH_BITS));
    const used = [...lengths.keys()].filter((pattern) => lengths[pattern] > 0);
    if (used.length === 1) {
      patterns.fill(used[0]);
      return used[0];
    }
    const { table } = this;
    let code = 0;
    for (let length = 1; length <= MOST_LENGTH; length++) {
      code <<= 1;
      for (const pattern of used) {
        if (lengths[pattern] !== length) continue;
        let first = 0;
        for (let bit = 0; bit < length; bit++) first |= ((code >> bit) & 1) << (length - 1 - bit);
        for (; first < table.length; first += 1 << length) table[first] = pattern | (length << 8);
        code++;
      }
    }
    if (code !== table.length) throw corrupt("packet: its patterns have no whole code");
    for (let i = 0; i < patterns.length; i++) {
      const found = table[this.peek() & (table.length - 1)];
      patterns[i] = found & 255;
      this.at += found >> 8;
    }
    return used.reduce((all, pattern) => all | pattern);
  }

  /** @param {Uint8Array} planes (10 + 3 K, P), zeros @param {number} count P @param {number} k */
  predicted(planes, count, k) {
    const patterns = new Uint8Array(count);
    for (const group of count > 0 ? groupsOf(k) : []) {
      const changing = this.patterns(group.length, patterns);
      for (const [n, plane] of group.entries()) {
        if (((changing >> n) & 1) === 0) continue;
        const first = this.take(CODE_BITS) * (MOST_ONES + 1);
        for (let i = 0, at = plane * count; i < count; i++, at++) {
          if (((patterns[i] >> n) & 1) === 0) continue;
          planes[at] = byteOf(this.value(first) + 1);
        }
      }
    }
  }

  /** @param {Uint8Array} planes (10 + 3 K, N) @param {number} count N */
  added(planes, count) {
    for (let at = 0; at < planes.length; ) {
      const centre = this.take(CENTRE_BITS);
      const first = this.take(CODE_BITS) * (MOST_ONES + 1);
      for (const end = at + count; at < end; at++) {
        const zigzag = byteOf(this.value(first));
        planes[at] = centre + ((zigzag >>> 1) ^ -(zigzag & 1));
      }
    }
  }

  /** The bytes behind the planes. @param {Uint8Array} body */
  rest(body) {
    const end = (this.at + 7) >> 3;
    if (this.at > this.numBits) throw corrupt("packet: ends inside its planes");
    if (this.at % 8 !== 0 && body[end - 1] >> this.at % 8 !== 0)
      throw corrupt("packet: a bit is set after its planes");
    return body.subarray(end);
  }
}

/** @param {number} value */
function byteOf(value) {
  if (value > 255) throw corrupt(`packet: a byte of ${value} in its planes`);
  return value;
}

/**
 * The change in a packet whose planes are coded. Memory stays within the limit. Throws a FormatError.
 * @param {Uint8Array} packet @param {number} limitBytes
 */
function changeContent(packet, limitBytes) {
  const reader = new ByteReader(packet, "packet");
  const [, flags, layer, reserved, birth] = reader.unpack(CODED_HEAD);
  if (reader.left < CHECKSUM_BYTES) throw corrupt("packet: is too short for a change");
  const body = reader.take(reader.left - CHECKSUM_BYTES);
  if (reader.u32() !== crc32(packet.subarray(0, -CHECKSUM_BYTES)))
    throw corrupt("packet: has a wrong checksum");
  const hasStarts = flags >> SH_DEGREE_BITS;
  if (hasStarts > 1 || reserved !== 0) throw unsupported("packet: a reserved bit is set");
  const planes = new PlaneReader(body);
  const [numPredicted, numNew, numEscapes] = [planes.number(), planes.number(), planes.number()];
  const k = ((flags & ((1 << SH_DEGREE_BITS) - 1)) + 1) ** 2;
  const numPlanes = 10 + 3 * k;
  const size = FIRST_PLANE + numPlanes * (numPredicted + numNew);
  const most = Math.min(limitBytes, MAX_CHUNK_BYTES, MAX_EXPANSION * packet.length);
  if (size > most) throw corrupt(`packet: ${size} bytes of content, at most ${most}`);
  const content = new Uint8Array(size + body.length);
  const longsAt = FIRST_PLANE + numPlanes * numPredicted;
  planes.predicted(content.subarray(FIRST_PLANE, longsAt), numPredicted, k);
  let numLong = 0;
  for (let at = FIRST_PLANE; at < FIRST_PLANE + 3 * numPredicted; at++)
    if (content[at] === LONG) numLong++;
  const added = new Uint8Array(numPlanes * numNew);
  planes.added(added, numNew);
  let numLowBits = 0;
  for (const length of added.subarray(0, 3 * numNew)) numLowBits += Math.max(length - 1, 0);
  const rest = planes.rest(body);
  const longBytes = 4 * numLong;
  if (longBytes > rest.length || size + rest.length > most)
    throw corrupt(`packet: ${rest.length} bytes behind its planes are too few or too many`);
  for (let n = 0; n < CHUNK_MAGIC.length; n++) content[n] = CHUNK_MAGIC.charCodeAt(n);
  content.set([CHUNK_KINDS.CHANGE, layer, hasStarts], 4);
  const head = new DataView(content.buffer);
  head.setInt32(8, birth, true);
  const counts = [numPredicted, numNew, numLong, numEscapes, (numLowBits + 7) >>> 3];
  for (const [n, count] of counts.entries()) head.setUint32(HEAD_BYTES + 4 * n, count, true);
  content.set(rest.subarray(0, longBytes), longsAt);
  content.set(added, longsAt + longBytes);
  content.set(rest.subarray(longBytes), longsAt + longBytes + added.length);
  return content.subarray(0, size + rest.length);
}

/**
 * The chunk in a packet of any kind; an empty packet gives an empty chunk. Memory stays within the limit. Throws a
 * FormatError.
 * @param {Uint8Array} packet @param {number} limitBytes
 */
export function packetContent(packet, limitBytes) {
  return packet[0] === CODED ? changeContent(packet, limitBytes) : zstdContent(packet, limitBytes);
}
