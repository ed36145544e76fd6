/**
 * Packets that are zstd frames (FORMAT.md, section 6; RFC 8878). A decoder of our own, because a hostile frame must not cost more time than
 * its content and its bytes: each copy is checked before it is made, and nothing but the content is
 * allocated.
 */

import { MAX_CHUNK_BYTES, MAX_EXPANSION, ZSTD_MAGIC } from "../constants.js";
import { corrupt } from "./bytes.js";
import { xxhash } from "./xxhash.js";

const CHECKSUM_BYTES = 4;
const MAX_BLOCK_BYTES = 1 << 17;
/** Kinds of blocks and of literals; 2 is a compressed one. */
const RAW = 0;
const REPEATED = 1;
const RESERVED = 3;
/** How a table of a block is given: by the standard, one symbol, a description, or as in the block before. */
const PREDEFINED = 0;
const ONE_SYMBOL = 1;
const DESCRIBED = 2;
const MAX_CODE_BITS = 11;
const MAX_WEIGHT_LOG = 6;
/** Most bits that one word of 32 gives from any place in a byte. */
const WORD_BITS = 25;

/** The table of a finite state coder: for each state its symbol, 8 bits, bits to read, 8, and the next state.
 * @typedef {{ log: number, states: Uint32Array }} Fse */
/** Codes of `log` bits at most: for each prefix its symbol, 8 bits, and the length of its code.
 * @typedef {{ log: number, codes: Uint16Array }} Huffman */
/** A kind of number in sequences. @typedef {{ maxLog: number, maxSymbol: number, standard: Fse }} Kind */

/** @param {boolean} isRight @returns {asserts isRight} */
function check(isRight) {
  if (!isRight) throw corrupt("packet: is a damaged zstd frame");
}

/** @param {number} value at least 1 */
const log2 = (value) => 31 - Math.clz32(value);

/** `count` bits, at most WORD_BITS, from bit `at` on. @param {DataView} view @param {number} at @param {number} count */
const bits = (view, at, count) => (view.getUint32(at >> 3, true) >>> (at & 7)) & ((1 << count) - 1);

/** First value of each code, for codes with so many more bits. @param {Uint8Array} extra @param {number} value */
const bases = (extra, value) =>
  Int32Array.from(extra, (count) => (value += 1 << count) - (1 << count));

const UPPER_BITS = [8, 9, 10, 11, 12, 13, 14, 15, 16];
const LITERAL_BITS = Uint8Array.of(...Array(16), 1, 1, 1, 1, 2, 2, 3, 3, 4, 6, 7, ...UPPER_BITS);
const MATCH_BITS = Uint8Array.of(...Array(32), 1, 1, 1, 1, 2, 2, 3, 3, 4, 4, 5, 7, ...UPPER_BITS);
const LITERAL_BASES = bases(LITERAL_BITS, 0);
const MATCH_BASES = bases(MATCH_BITS, 3);

/** @param {number[]} shares of the symbols, -1 for less than one state @param {number} log @returns {Fse} */
function fseTable(shares, log) {
  const size = 1 << log;
  const symbols = new Uint8Array(size);
  let high = size;
  for (let symbol = 0; symbol < shares.length; symbol++)
    if (shares[symbol] < 0) symbols[--high] = symbol;
  let at = 0;
  for (let symbol = 0; symbol < shares.length; symbol++) {
    for (let left = shares[symbol]; left > 0; left--) {
      symbols[at] = symbol;
      do at = (at + (size >> 1) + (size >> 3) + 3) & (size - 1);
      while (at >= high);
    }
  }
  const next = shares.map(Math.abs);
  const states = new Uint32Array(size);
  for (let n = 0; n < size; n++) {
    const state = next[symbols[n]]++;
    const count = log - log2(state);
    states[n] = symbols[n] | (count << 8) | (((state << count) - size) << 16);
  }
  return { log, states };
}

/** @param {string} digits one for each symbol, `-` for -1 @param {number} log */
const standard = (digits, log) =>
  fseTable(
    Array.from(digits, (digit) => (digit === "-" ? -1 : Number(digit))),
    log,
  );

/** Of literal lengths, offsets and match lengths, in the order of their tables. @type {Kind[]} */
const KINDS = [
  { maxLog: 9, maxSymbol: 35, standard: standard("43222222222221112222222223211111----", 6) },
  { maxLog: 8, maxSymbol: 31, standard: standard("111111222111111111111111-----", 5) },
  {
    maxLog: 9,
    maxSymbol: 52,
    standard: standard(`143222222${"1".repeat(37)}-------`, 6),
  },
];

/** What is decoded now: one frame after another, so that nothing has to be passed on. */
/** @type {Uint8Array} */
let frame = new Uint8Array(0);
let view = new DataView(frame.buffer);
let content = frame;
/** Number of bytes of `content` that are there. */
let filled = 0;
/** Most bytes of a block. */
let blockBytes = 0;
/** Where in the frame the decoder reads, and where its block ends; the checksum is behind. */
let position = 0;
let blockEnd = 0;
/** @type {Huffman | null} */
let huffman = null;
/** @type {(Fse | null)[]} of literal lengths, offsets and match lengths */
let tables = [];
/** @type {number[]} */
let offsets = [];

/** Decodes all blocks from `at` on. @param {number} at */
function blocks(at) {
  const last = frame.length - CHECKSUM_BYTES;
  for (let isLast = false; !isLast; ) {
    check(at + 3 <= last);
    const head = view.getUint32(at, true) & 0xffffff;
    const [kind, size] = [(head >> 1) & 3, head >> 3];
    isLast = (head & 1) === 1;
    at += 3;
    position = at;
    at += kind === REPEATED ? 1 : size;
    blockEnd = at;
    check(kind !== RESERVED && at <= last && size <= blockBytes);
    if (kind === RAW || kind === REPEATED) {
      const end = filled + size;
      check(end <= content.length);
      if (kind === RAW) content.set(frame.subarray(position, at), filled);
      else content.fill(frame[position], filled, end);
      filled = end;
    } else block();
  }
  check(at === last && filled === content.length);
  if (view.getUint32(last, true) !== xxhash(content))
    throw corrupt("packet: the content has another checksum than the packet says");
}

/** The next byte of the block. */
function takeByte() {
  check(position < blockEnd);
  return frame[position++];
}

/** The next bytes of the block. @param {number} size */
function takeBytes(size) {
  const from = position;
  position += size;
  check(position <= blockEnd);
  return frame.subarray(from, position);
}

/** A compressed block. Its literals wait at the end of the place for its content. */
function block() {
  const limit = Math.min(content.length, filled + blockBytes);
  const literals = putLiterals(filled, limit);
  const first = takeByte();
  let count = first;
  if (first === 255) count = takeByte() + (takeByte() << 8) + 0x7f00;
  else if (first > 127) count = ((first - 128) << 8) + takeByte();
  if (count === 0) {
    check(position === blockEnd);
    content.copyWithin(filled, literals, limit);
    filled = filled + limit - literals;
    return;
  }
  const modes = takeByte();
  check((modes & 3) === 0);
  for (const [n, kind] of KINDS.entries())
    tables[n] = tableOf(kind, (modes >> (6 - 2 * n)) & 3, tables[n]);
  sequences(count, literals, limit);
}

/** Decodes the literals of a block to before `limit`; returns where they begin. @param {number} least @param {number} limit */
function putLiterals(least, limit) {
  const first = takeByte();
  const [kind, form] = [first & 3, (first >> 2) & 3];
  if (kind === RAW || kind === REPEATED) {
    let size = first >> 3;
    if (form & 1) size = (first >> 4) | (takeByte() << 4);
    if (form === 3) size |= takeByte() << 12;
    const from = limit - size;
    check(from >= least);
    if (kind === RAW) content.set(takeBytes(size), from);
    else content.fill(takeByte(), from, limit);
    return from;
  }
  // Two sizes of 10, 10, 14 or 18 bits, in bytes of which the first 20 bits are in `head`.
  const sizeBits = form < 2 ? 10 : 4 * form + 6;
  const head = (first >> 4) | (takeByte() << 4) | (takeByte() << 12);
  let coded = head >> sizeBits;
  if (form > 1) coded |= takeByte() << (20 - sizeBits);
  if (form > 2) coded |= takeByte() << (28 - sizeBits);
  const from = limit - (head & ((1 << sizeBits) - 1));
  const end = position + coded;
  check(from >= least && end <= blockEnd);
  if (kind === 2) huffman = codesOf(end);
  const [at, table] = [position, huffman];
  check(table !== null);
  position = end;
  if (form === 0) {
    decodeStream(at, end, from, limit, table);
    return from;
  }
  check(end - at >= 6);
  const quarter = (limit - from + 3) >> 2;
  check(3 * quarter <= limit - from);
  let begin = at + 6;
  for (let n = 0; n < 4; n++) {
    const stop = n < 3 ? begin + (frame[at + 2 * n] | (frame[at + 2 * n + 1] << 8)) : end;
    check(stop <= end);
    const to = n < 3 ? from + (n + 1) * quarter : limit;
    decodeStream(begin, stop, from + n * quarter, to, table);
    begin = stop;
  }
  return from;
}

/** The last bit of a stream that is read from its end, whose highest one marks it. @param {number} begin @param {number} end */
function lastBit(begin, end) {
  check(end > begin && frame[end - 1] > 0);
  return 8 * end - 8 + log2(frame[end - 1]);
}

/**
 * Decodes a stream of Huffman codes, which lies from `begin` to `end`, to the content from `from` to `to`.
 * @param {number} begin @param {number} end @param {number} from @param {number} to @param {Huffman} huffman
 */
function decodeStream(begin, end, from, to, { log, codes }) {
  const [out, data] = [content, view];
  const first = 8 * begin;
  let at = lastBit(begin, end);
  // Two codes from each word, as long as both lie within the stream.
  for (let start = at - 2 * log; to - from > 1 && start >= first; start = at - 2 * log) {
    const word = bits(data, start, 2 * log);
    const one = codes[word >> log];
    at -= one >> 8;
    const other = codes[(word >> (at - log - start)) & ((1 << log) - 1)];
    at -= other >> 8;
    out[from++] = one;
    out[from++] = other;
  }
  for (; from < to; from++) {
    // What lies before the stream is not its own, and no code takes it.
    const code = codes[bits(data, at - log, log)];
    at -= code >> 8;
    out[from] = code;
    check(at >= first);
  }
  check(at === first);
}

/** The codes of literals; their description ends before `end`. @param {number} end @returns {Huffman} */
function codesOf(end) {
  const head = takeByte();
  /** @type {number[]} of the symbols; 0 if it does not occur */
  let weights = [];
  if (head < 128) {
    const stop = position + head;
    check(stop <= end);
    weights = readWeights(stop);
    position = stop;
  } else {
    const pairs = takeBytes((head - 126) >> 1);
    for (const pair of pairs) weights.push(pair >> 4, pair & 15);
    weights.length = head - 127;
  }
  check(position <= end);
  const sum = weights.reduce((all, weight) => all + ((1 << weight) >> 1), 0);
  check(sum > 0 && sum < 1 << MAX_CODE_BITS && Math.max(...weights) <= MAX_CODE_BITS);
  const log = log2(sum) + 1;
  const rest = (1 << log) - sum;
  check((rest & (rest - 1)) === 0);
  weights.push(log2(rest) + 1);
  /** Of each weight where its codes begin: the longest codes come first. */
  const next = new Uint16Array(MAX_CODE_BITS + 2);
  for (const weight of weights) next[weight + 1] += (1 << weight) >> 1;
  for (let weight = 1; weight <= log; weight++) next[weight + 1] += next[weight];
  const codes = new Uint16Array(1 << log);
  for (let symbol = 0; symbol < weights.length; symbol++) {
    const weight = weights[symbol];
    const from = next[weight];
    next[weight] += (1 << weight) >> 1;
    codes.fill(symbol | ((log + 1 - weight) << 8), from, next[weight]);
  }
  return { log, codes };
}

/** The weights of symbols, by two finite state coders in turn. @param {number} end */
function readWeights(end) {
  const { log, states } = readTable(end, MAX_WEIGHT_LOG, 255);
  const first = 8 * position;
  let at = lastBit(position, end) - 2 * log;
  check(at >= first);
  let state = states[bits(view, at + log, log)];
  let other = states[bits(view, at, log)];
  const weights = /** @type {number[]} */ ([]);
  for (;;) {
    weights.push(state & 255);
    check(weights.length < 255);
    const count = (state >> 8) & 255;
    at -= count;
    if (at < first) break;
    [state, other] = [other, states[(state >>> 16) + bits(view, at, count)]];
  }
  weights.push(other & 255);
  return weights;
}

/** The table of a kind of number. @param {Kind} kind @param {number} mode @param {Fse | null} before @returns {Fse} */
function tableOf({ maxLog, maxSymbol, standard }, mode, before) {
  if (mode === PREDEFINED) return standard;
  if (mode === DESCRIBED) return readTable(blockEnd, maxLog, maxSymbol);
  if (mode !== ONE_SYMBOL) {
    check(before !== null);
    return before;
  }
  const symbol = takeByte();
  check(symbol <= maxSymbol);
  return { log: 0, states: Uint32Array.of(symbol) };
}

/** The table whose description comes next. @param {number} end @param {number} maxLog @param {number} maxSymbol */
function readTable(end, maxLog, maxSymbol) {
  const last = 8 * end;
  let at = 8 * position;
  check(at < last);
  const log = bits(view, at, 4) + 5;
  check(log <= maxLog);
  at += 4;
  let left = 1 << log;
  /** @type {number[]} */
  const shares = [];
  while (left > 0) {
    check(at < last && shares.length <= maxSymbol);
    // Of the values up to left + 1 the lowest take a bit less.
    const count = log2(left + 1);
    const short = (2 << count) - 2 - left;
    const value = bits(view, at, count + 1);
    const low = value & ((1 << count) - 1);
    at += low < short ? count : count + 1;
    const share = (low < short ? low : value >> count ? value - short : value) - 1;
    shares.push(share);
    left -= Math.abs(share);
    for (let zeros = share === 0 ? 3 : 0; zeros === 3; ) {
      check(at < last && shares.length <= maxSymbol);
      zeros = bits(view, at, 2);
      at += 2;
      for (let n = 0; n < zeros; n++) shares.push(0);
    }
  }
  check(left === 0 && at <= last && shares.length <= maxSymbol + 1);
  position = (at + 7) >> 3;
  return fseTable(shares, log);
}

/**
 * Makes the content of a block: literals, which lie from `literal` to `limit`, and copies of what is there.
 * @param {number} count number of sequences @param {number} literal @param {number} limit
 */
function sequences(count, literal, limit) {
  const [out, data, recent] = [content, view, offsets];
  const [literals, distances, matches] = /** @type {Fse[]} */ (tables);
  const first = 8 * position;
  let at = lastBit(position, blockEnd);
  let to = filled;
  const start = (/** @type {Fse} */ { log, states }) => states[bits(data, (at -= log), log)];
  let literalState = start(literals);
  let distanceState = start(distances);
  let matchState = start(matches);
  for (let left = count; left > 0; left--) {
    // At most 63 bits, and 26 for the states before: there are 12 bytes of heads in front of `first`.
    let value = 0;
    let more = distanceState & 255;
    if (more > WORD_BITS) {
      value = bits(data, (at -= more - WORD_BITS), more - WORD_BITS) << WORD_BITS;
      more = WORD_BITS;
    }
    value = (1 << (distanceState & 255)) + value + bits(data, (at -= more), more);
    more = MATCH_BITS[matchState & 255];
    const length = MATCH_BASES[matchState & 255] + bits(data, (at -= more), more);
    more = LITERAL_BITS[literalState & 255];
    const run = LITERAL_BASES[literalState & 255] + bits(data, (at -= more), more);
    check(at >= first);
    if (left > 1) {
      more = (literalState >> 8) & 255;
      literalState = literals.states[(literalState >>> 16) + bits(data, (at -= more), more)];
      more = (matchState >> 8) & 255;
      matchState = matches.states[(matchState >>> 16) + bits(data, (at -= more), more)];
      more = (distanceState >> 8) & 255;
      distanceState = distances.states[(distanceState >>> 16) + bits(data, (at -= more), more)];
    }
    let distance = value - 3;
    if (value <= 3) {
      const n = value - (run > 0 ? 1 : 0);
      distance = n < 3 ? recent[n] : recent[0] - 1;
      if (n > 1) recent[2] = recent[1];
      if (n > 0) recent[1] = recent[0];
    } else {
      recent[2] = recent[1];
      recent[1] = recent[0];
    }
    recent[0] = distance;
    check(run <= limit - literal);
    const end = to + run + length;
    check(end <= literal + run && distance > 0 && distance <= to + run);
    for (let n = 0; n < run; n++) out[to++] = out[literal++];
    for (; to < end; to++) out[to] = out[to - distance];
  }
  check(at === first);
  content.copyWithin(to, literal, limit);
  filled = to + limit - literal;
}

/**
 * What the head of a zstd frame says: where the blocks begin, the size of the content, which must be stated, and most
 * bytes of a block. Throws a FormatError unless there is a checksum, and no dictionary.
 * @param {Uint8Array} frame
 */
function readFrameHead(frame) {
  const view = new DataView(frame.buffer, frame.byteOffset, frame.length);
  const flags = frame.length > 4 ? frame[4] : 0;
  const isSingle = (flags & 32) !== 0;
  const sizeBytes = flags < 64 ? Number(isSingle) : 1 << (flags >> 6);
  const idBytes = [0, 1, 2, 4][flags & 3];
  const idAt = isSingle ? 5 : 6;
  const at = idAt + idBytes;
  const begin = at + sizeBytes;
  const isFrame = ZSTD_MAGIC.every((byte, i) => frame[i] === byte) && (flags & 8) === 0;
  if (!isFrame || frame.length < begin + 3 + CHECKSUM_BYTES)
    throw corrupt("packet: is not a zstd frame");
  if (sizeBytes === 0) throw corrupt("packet: does not state the size of its content");
  if ((flags & 4) === 0 || frame.subarray(idAt, at).some((byte) => byte > 0))
    throw corrupt("packet: has no checksum, or needs a dictionary");
  const low = sizeBytes < 4 ? 0 : view.getUint32(at, true);
  const size =
    sizeBytes === 1
      ? frame[at]
      : sizeBytes === 2
        ? 256 + view.getUint16(at, true)
        : low + (sizeBytes === 8 ? 2 ** 32 * view.getUint32(at + 4, true) : 0);
  const window = isSingle ? size : 2 ** (10 + (frame[5] >> 3)) * (1 + (frame[5] & 7) / 8);
  if (window >= 2 ** 32) throw corrupt("packet: its window is too large");
  return { begin, size, blockBytes: Math.min(window, MAX_BLOCK_BYTES) };
}

/**
 * The chunk in a zstd frame; an empty packet gives an empty chunk. Memory stays within the limit. Throws a FormatError
 * unless the content fills its stated size exactly, has the stated checksum and ends where `packet` does.
 * @param {Uint8Array} packet @param {number} limitBytes
 */
export function zstdContent(packet, limitBytes) {
  if (packet.length === 0) return packet;
  const head = readFrameHead(packet);
  if (head.size === 0) throw corrupt("packet: its content is empty");
  const most = Math.min(limitBytes, MAX_CHUNK_BYTES, MAX_EXPANSION * packet.length);
  if (head.size > most)
    throw corrupt(`packet: ${head.size} bytes of content, but at most ${most} are allowed`);
  frame = packet;
  view = new DataView(frame.buffer, frame.byteOffset, frame.length);
  content = new Uint8Array(head.size);
  filled = 0;
  blockBytes = head.blockBytes;
  huffman = null;
  tables = [null, null, null];
  offsets = [1, 4, 8];
  blocks(head.begin);
  return content;
}
