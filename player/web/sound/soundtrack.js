import { PREROLL, SAMPLE_RATE } from "../constants.js";
import { corrupt } from "../format/bytes/errors.js";
import { oggOf } from "./ogg.js";
import { checkSpan, readSoundObject } from "./soundobject.js";

/** Maximum number of objects that are fetched at the same time. */
const MOST_FETCHES = 2;

/** @typedef {import("./timeline.js").Timeline} Timeline */
/** @typedef {import("./timeline.js").Piece} Piece */
/** @typedef {import("./soundobject.js").SoundObject} SoundObject */

/**
 * The sound of one source, a little ahead of playback: objects are fetched, and pieces of them decoded.
 * Refused objects are silent.
 */
export class SoundTrack {
  /** @type {Map<number, SoundObject | null>} by segment; null: being fetched */
  #objects = new Map();
  /** @type {Map<number, Float32Array[] | null>} samples of each channel by begin; null: being decoded */
  #pieces = new Map();
  /** @type {Map<number, AbortController>} pending fetches, by segment */
  #fetches = new Map();
  #isClosed = false;

  /**
   * @param {import("./soundsource.js").SoundSource} source
   * @param {Timeline} timeline
   * @param {(segment: number, part: string, signal: AbortSignal) => Promise<Uint8Array>} fetchObject
   * @param {(file: ArrayBuffer) => Promise<AudioBuffer>} decode at 48000 Hz
   * @param {(error: unknown) => void} refused called with the error of a refused object
   */
  constructor(source, timeline, fetchObject, decode, refused) {
    this.source = source;
    this.timeline = timeline;
    this.fetchObject = fetchObject;
    this.decode = decode;
    this.refused = refused;
  }

  /** Bytes of the objects that are held. */
  get numBytes() {
    let numBytes = 0;
    for (const object of this.#objects.values()) numBytes += object?.numBytes ?? 0;
    return numBytes;
  }

  /**
   * Fetches the objects of these pieces, in order, and drops everything else.
   * @param {Piece[]} pieces
   * @param {number} numDecoded number of first pieces that are also decoded
   * @param {boolean} [isFull] whether to fetch only the first piece's object, and nothing ahead
   * @param {(numBefore: number) => boolean} [allows] whether to fetch a piece now that has this many samples
   *   of other pieces before it
   */
  want(pieces, numDecoded, isFull = false, allows = () => true) {
    const segments = new Set(pieces.map(({ segment }) => segment));
    for (const segment of this.#objects.keys()) {
      if (segments.has(segment)) continue;
      this.#fetches.get(segment)?.abort();
      this.#fetches.delete(segment);
      this.#objects.delete(segment);
    }
    let numBefore = 0;
    for (const { segment, begin, end } of pieces) {
      if (!this.#objects.has(segment)) {
        if (this.#fetches.size >= MOST_FETCHES || !allows(numBefore)) break;
        this.#fetch(segment);
      }
      if (isFull) break;
      numBefore += end - begin;
    }
    const soon = pieces.slice(0, numDecoded);
    const begins = new Set(soon.map(({ begin }) => begin));
    for (const [begin, samples] of this.#pieces)
      if (samples !== null && !begins.has(begin)) this.#pieces.delete(begin);
    for (const piece of soon) {
      const object = this.#objects.get(piece.segment);
      if (object && !this.#pieces.has(piece.begin)) this.#decode(piece, object);
    }
  }

  /** The samples of each channel of a piece; null until they are decoded. @param {number} begin */
  samples(begin) {
    return this.#pieces.get(begin) ?? null;
  }

  /** @param {number} segment */
  async #fetch(segment) {
    const { part, channels } = this.source;
    const fetching = new AbortController();
    this.#objects.set(segment, null);
    this.#fetches.set(segment, fetching);
    /** @type {SoundObject} */
    let object = { preSkip: 0, numSamples: 0, packets: [], positions: [0], numBytes: 0 };
    try {
      const bytes = await this.fetchObject(segment, part, fetching.signal);
      const found = readSoundObject(bytes, channels);
      checkSpan(found, ...this.timeline.span(segment));
      object = found;
    } catch (error) {
      if (!fetching.signal.aborted) this.refused(error);
    }
    if (fetching.signal.aborted) return;
    this.#objects.set(segment, object);
    this.#fetches.delete(segment);
  }

  /**
   * @param {Piece} piece
   * @param {SoundObject} object
   */
  async #decode({ begin, end }, object) {
    const { channels } = this.source;
    const samples = Array.from({ length: channels }, () => new Float32Array(end - begin));
    this.#pieces.set(begin, null);
    try {
      await this.#fill(samples, begin, Math.min(end, object.numSamples), object);
    } catch (error) {
      if (!this.#isClosed) this.refused(error);
    }
    if (!this.#isClosed) this.#pieces.set(begin, samples);
  }

  /**
   * Decodes the samples from `begin` to `end`.
   * @param {Float32Array[]} samples
   * @param {number} begin
   * @param {number} end
   * @param {SoundObject} object
   */
  async #fill(samples, begin, end, { preSkip, packets, positions }) {
    if (begin >= end) return;
    const least = Math.max(0, begin + preSkip - PREROLL);
    const from = positions.findLastIndex((position) => position <= least);
    const to = positions.findIndex((position) => position >= end + preSkip);
    if (from < 0 || to < 0) throw corrupt(`sound: no packets for samples ${begin} to ${end}`);
    const first = positions[from];
    const ends = positions.slice(from + 1, to + 1).map((position) => position - first);
    const file = oggOf(packets.slice(from, to), ends, samples.length);
    const decoded = await this.decode(file.buffer);
    const total = ends[ends.length - 1];
    // Some decoders omit samples at the beginning of every file, so samples are counted from the end.
    const at = begin + preSkip - first - (total - decoded.length);
    if (decoded.sampleRate !== SAMPLE_RATE || at < 0 || decoded.length > total)
      throw corrupt(`sound: ${decoded.length} samples were decoded of ${total}`);
    for (const [n, channel] of samples.entries()) {
      const found = decoded.getChannelData(Math.min(n, decoded.numberOfChannels - 1));
      channel.set(found.subarray(at, at + end - begin));
    }
  }

  close() {
    this.#isClosed = true;
    for (const fetching of this.#fetches.values()) fetching.abort();
    this.#objects.clear();
    this.#pieces.clear();
  }
}
