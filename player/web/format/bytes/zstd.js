/**
 * Decodes zstd frames (RFC 8878). A decoder of our own, because a hostile frame must not cost more time than its
 * content and its bytes: each copy is checked before it is made, and nothing but the content is allocated.
 */
import { ZSTD_MAGIC } from "../../constants.js";
import { corrupt } from "./errors.js";
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

/** Decodes the blocks of one frame into `content`. */
class FrameDecoder {
  /**
   * @param {Uint8Array} frame
   * @param {Uint8Array} content
   * @param {number} blockBytes most bytes of a block
   */
  constructor(frame, content, blockBytes) {
    this.frame = frame;
    this.view = new DataView(frame.buffer, frame.byteOffset, frame.length);
    this.content = content;
    this.blockBytes = blockBytes;
    /** Number of bytes of `content` that are there. */
    this.filled = 0;
    /** Where in the frame the decoder reads, and where its block ends; the checksum is behind. */
    this.at = 0;
    this.end = 0;
    /** @type {Huffman | null} */
    this.huffman = null;
    /** @type {(Fse | null)[]} of literal lengths, offsets and match lengths */
    this.tables = [null, null, null];
    this.offsets = [1, 4, 8];
  }

  /** Decodes all blocks from `at` on. @param {number} at */
  decode(at) {
    const { view, content, frame } = this;
    const last = frame.length - CHECKSUM_BYTES;
    for (let isLast = false; !isLast; ) {
      check(at + 3 <= last);
      const head = view.getUint32(at, true) & 0xffffff;
      const [kind, size] = [(head >> 1) & 3, head >> 3];
      isLast = (head & 1) === 1;
      at += 3;
      this.at = at;
      at += kind === REPEATED ? 1 : size;
      this.end = at;
      check(kind !== RESERVED && at <= last && size <= this.blockBytes);
      if (kind === RAW || kind === REPEATED) {
        const end = this.filled + size;
        check(end <= content.length);
        if (kind === RAW) content.set(frame.subarray(this.at, at), this.filled);
        else content.fill(frame[this.at], this.filled, end);
        this.filled = end;
      } else this.#block();
    }
    check(at === last && this.filled === content.length);
    if (view.getUint32(last, true) !== xxhash(content))
      throw corrupt("packet: the content has another checksum than the packet says");
  }

  /** The next byte of the block. */
  #byte() {
    check(this.at < this.end);
    return this.frame[this.at++];
  }

  /** The next bytes of the block. @param {number} size */
  #bytes(size) {
    const from = this.at;
    this.at += size;
    check(this.at <= this.end);
    return this.frame.subarray(from, this.at);
  }

  /** A compressed block. Its literals wait at the end of the place for its content. */
  #block() {
    const { content, filled } = this;
    const limit = Math.min(content.length, filled + this.blockBytes);
    const literals = this.#literals(filled, limit);
    const first = this.#byte();
    let count = first;
    if (first === 255) count = this.#byte() + (this.#byte() << 8) + 0x7f00;
    else if (first > 127) count = ((first - 128) << 8) + this.#byte();
    if (count === 0) {
      check(this.at === this.end);
      content.copyWithin(filled, literals, limit);
      this.filled = filled + limit - literals;
      return;
    }
    const modes = this.#byte();
    check((modes & 3) === 0);
    for (const [n, kind] of KINDS.entries()) {
      this.tables[n] = this.#table(kind, (modes >> (6 - 2 * n)) & 3, this.tables[n]);
    }
    this.#sequences(count, literals, limit);
  }

  /** Decodes the literals of a block to before `limit`; returns where they begin. @param {number} least @param {number} limit */
  #literals(least, limit) {
    const { content, frame } = this;
    const first = this.#byte();
    const [kind, form] = [first & 3, (first >> 2) & 3];
    if (kind === RAW || kind === REPEATED) {
      let size = first >> 3;
      if (form & 1) size = (first >> 4) | (this.#byte() << 4);
      if (form === 3) size |= this.#byte() << 12;
      const from = limit - size;
      check(from >= least);
      if (kind === RAW) content.set(this.#bytes(size), from);
      else content.fill(this.#byte(), from, limit);
      return from;
    }
    // Two sizes of 10, 10, 14 or 18 bits, in bytes of which the first 20 bits are in `head`.
    const sizeBits = form < 2 ? 10 : 4 * form + 6;
    const head = (first >> 4) | (this.#byte() << 4) | (this.#byte() << 12);
    let coded = head >> sizeBits;
    if (form > 1) coded |= this.#byte() << (20 - sizeBits);
    if (form > 2) coded |= this.#byte() << (28 - sizeBits);
    const from = limit - (head & ((1 << sizeBits) - 1));
    const end = this.at + coded;
    check(from >= least && end <= this.end);
    if (kind === 2) this.huffman = this.#huffman(end);
    check(this.huffman !== null);
    const { at, huffman } = this;
    this.at = end;
    if (form === 0) {
      this.#decode(at, end, from, limit, huffman);
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
      this.#decode(begin, stop, from + n * quarter, to, huffman);
      begin = stop;
    }
    return from;
  }

  /** The last bit of a stream that is read from its end, whose highest one marks it. @param {number} begin @param {number} end */
  #lastBit(begin, end) {
    check(end > begin && this.frame[end - 1] > 0);
    return 8 * end - 8 + log2(this.frame[end - 1]);
  }

  /**
   * Decodes a stream of Huffman codes, which lies from `begin` to `end`, to the content from `from` to `to`.
   * @param {number} begin
   * @param {number} end
   * @param {number} from
   * @param {number} to
   * @param {Huffman} huffman
   */
  #decode(begin, end, from, to, { log, codes }) {
    const { content, view } = this;
    const first = 8 * begin;
    let at = this.#lastBit(begin, end);
    for (; from < to; from++) {
      // What lies before the stream is not its own, and no code takes it.
      const code = codes[bits(view, at - log, log)];
      at -= code >> 8;
      content[from] = code;
      check(at >= first);
    }
    check(at === first);
  }

  /** The codes of literals; their description ends before `end`. @param {number} end @returns {Huffman} */
  #huffman(end) {
    const head = this.#byte();
    /** @type {number[]} of the symbols; 0 if it does not occur */
    let weights = [];
    if (head < 128) {
      const stop = this.at + head;
      check(stop <= end);
      weights = this.#weights(stop);
      this.at = stop;
    } else {
      const pairs = this.#bytes((head - 126) >> 1);
      for (const pair of pairs) weights.push(pair >> 4, pair & 15);
      weights.length = head - 127;
    }
    check(this.at <= end);
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
  #weights(end) {
    const { view } = this;
    const { log, states } = this.#described(end, MAX_WEIGHT_LOG, 255);
    const first = 8 * this.at;
    let at = this.#lastBit(this.at, end) - 2 * log;
    check(at >= first);
    let state = states[bits(view, at + log, log)];
    let other = states[bits(view, at, log)];
    const weights = [];
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
  #table({ maxLog, maxSymbol, standard }, mode, before) {
    if (mode === PREDEFINED) return standard;
    if (mode === DESCRIBED) return this.#described(this.end, maxLog, maxSymbol);
    if (mode !== ONE_SYMBOL) {
      check(before !== null);
      return before;
    }
    const symbol = this.#byte();
    check(symbol <= maxSymbol);
    return { log: 0, states: Uint32Array.of(symbol) };
  }

  /** The table whose description comes next. @param {number} end @param {number} maxLog @param {number} maxSymbol */
  #described(end, maxLog, maxSymbol) {
    const { view } = this;
    const last = 8 * end;
    let at = 8 * this.at;
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
    this.at = (at + 7) >> 3;
    return fseTable(shares, log);
  }

  /**
   * Makes the content of a block: literals, which lie from `literal` to `limit`, and copies of what is there.
   * @param {number} count number of sequences
   * @param {number} literal
   * @param {number} limit
   */
  #sequences(count, literal, limit) {
    const { content, view, offsets } = this;
    const [literals, distances, matches] = /** @type {Fse[]} */ (this.tables);
    const first = 8 * this.at;
    let at = this.#lastBit(this.at, this.end);
    let to = this.filled;
    const start = (/** @type {Fse} */ { log, states }) => states[bits(view, (at -= log), log)];
    let literalState = start(literals);
    let distanceState = start(distances);
    let matchState = start(matches);
    for (let left = count; left > 0; left--) {
      // At most 63 bits, and 26 for the states before: there are 12 bytes of heads in front of `first`.
      let value = 0;
      let more = distanceState & 255;
      if (more > WORD_BITS) {
        value = bits(view, (at -= more - WORD_BITS), more - WORD_BITS) << WORD_BITS;
        more = WORD_BITS;
      }
      value = (1 << (distanceState & 255)) + value + bits(view, (at -= more), more);
      more = MATCH_BITS[matchState & 255];
      const length = MATCH_BASES[matchState & 255] + bits(view, (at -= more), more);
      more = LITERAL_BITS[literalState & 255];
      const run = LITERAL_BASES[literalState & 255] + bits(view, (at -= more), more);
      check(at >= first);
      if (left > 1) {
        more = (literalState >> 8) & 255;
        literalState = literals.states[(literalState >>> 16) + bits(view, (at -= more), more)];
        more = (matchState >> 8) & 255;
        matchState = matches.states[(matchState >>> 16) + bits(view, (at -= more), more)];
        more = (distanceState >> 8) & 255;
        distanceState = distances.states[(distanceState >>> 16) + bits(view, (at -= more), more)];
      }
      let distance = value - 3;
      if (value <= 3) {
        const n = value - (run > 0 ? 1 : 0);
        distance = n < 3 ? offsets[n] : offsets[0] - 1;
        if (n > 1) offsets[2] = offsets[1];
        if (n > 0) offsets[1] = offsets[0];
      } else {
        offsets[2] = offsets[1];
        offsets[1] = offsets[0];
      }
      offsets[0] = distance;
      check(run <= limit - literal);
      const end = to + run + length;
      check(end <= literal + run && distance > 0 && distance <= to + run);
      for (let n = 0; n < run; n++) content[to++] = content[literal++];
      for (; to < end; to++) content[to] = content[to - distance];
    }
    check(at === first);
    content.copyWithin(to, literal, limit);
    this.filled = to + limit - literal;
  }
}

/**
 * What the head of a zstd frame says: where the blocks begin, the size of the content, which must be stated, and most
 * bytes of a block. Throws a FormatError unless there is a checksum, and no dictionary.
 * @param {Uint8Array} frame
 */
export function readFrameHead(frame) {
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
 * The content of a zstd frame with this head. Throws a FormatError unless it fills its stated size exactly, has the
 * stated checksum and ends where `frame` does.
 * @param {Uint8Array} frame
 * @param {ReturnType<typeof readFrameHead>} head
 */
export function decodeFrame(frame, { begin, size, blockBytes }) {
  const content = new Uint8Array(size);
  new FrameDecoder(frame, content, blockBytes).decode(begin);
  return content;
}
