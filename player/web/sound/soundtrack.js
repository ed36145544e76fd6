/** The track of a source of sound: where the source is, when its segments are fetched, and their samples. */

import { MAX_SOUND_KEYS, MAX_SOURCES, PREROLL, SAMPLE_RATE, SOUND_PREFIX } from "../constants.js";
import { corrupt } from "../format/bytes.js";
import { field, integer, list, number, text } from "../format/json.js";
import { inCamera } from "../view/pose.js";
import { checkSpan, oggOf, readSoundObject } from "./soundobject.js";

/** Limit of coordinates: nothing is audible farther away, and devices need finite binary32 numbers. */
const FAR_M = 1e6;

/**
 * A sound source of a stream.
 * @typedef {object} SoundSource
 * @property {string} part the part name of its objects, in place of a layer's number
 * @property {number} channels
 * @property {number[][]} keys time in seconds and place in metres; empty for sound without a place
 */

/**
 * The sources that a manifest's `sound` describes. Throws a FormatError.
 * @param {unknown} value @returns {SoundSource[]}
 */
export function readSources(value) {
  const sources = list(value, 0, MAX_SOURCES, "sound").map(readSource);
  if (new Set(sources.map(({ part }) => part)).size !== sources.length)
    throw corrupt("manifest: two sources of sound have the same name");
  return sources;
}

/** @param {unknown} value @returns {SoundSource} */
function readSource(value) {
  const name = text(field(value, "name"), "name");
  if (!/^[a-z0-9]{1,32}$/.test(name)) throw corrupt("manifest: a source of sound has no such name");
  const keys = list(field(value, "keys"), 0, MAX_SOUND_KEYS, "keys").map((key) =>
    list(key, 4, 4, "a place of a sound").map((item) => number(item, "keys")),
  );
  if (keys.some(([timeS], n) => n > 0 && timeS <= keys[n - 1][0]))
    throw corrupt(`manifest: the places of sound ${name} are not in order of time`);
  const channels = integer(field(value, "channels"), 1, keys.length > 0 ? 1 : 2, "channels");
  return { part: SOUND_PREFIX + name, channels, keys };
}

/**
 * The place of a source with keys.
 * @param {number[][]} keys @param {number} timeS @returns {import("../view/vectors.js").Vector}
 */
export function placeAt(keys, timeS) {
  const after = keys.findIndex(([keyS]) => keyS > timeS);
  if (after <= 0) return (after === 0 ? keys[0] : keys[keys.length - 1]).slice(1);
  const [from, to] = [keys[after - 1], keys[after]];
  const share = (timeS - from[0]) / (to[0] - from[0]);
  return [1, 2, 3].map((axis) => from[axis] + share * (to[axis] - from[axis]));
}

/**
 * The place of a source with keys relative to a listener facing -z with y up, metres; always finite.
 * @param {number[][]} keys @param {number} timeS @param {number[]} w2c (4, 4) world to camera
 */
export function heardAt(keys, timeS, w2c) {
  const [right, down, forward] = inCamera(w2c, placeAt(keys, timeS));
  return [right, -down, -forward].map((at) => Math.max(-FAR_M, Math.min(FAR_M, at)) || 0);
}

/** After a segment was fetched, the link is left to the pictures for this multiple of its fetch time. */
const REST_SHARE = 4;
/** Fetch and rest take at most this share of the segment's duration, so that the lead of the sound grows. */
const GROWTH_SHARE = 0.8;
/** A segment due in less than this plus twice the last fetch time is fetched without waiting for the rest. */
const URGENT_MS = 300;

/**
 * Decides when the next segment of sound may be fetched, and when the link is left to the pictures. If
 * the link carries little more than layer 0, fetching many seconds of sound at once would stall the
 * pictures, and with them the sound.
 */
export class FetchPace {
  #tookMs = 0;
  #restsUntilMs = -Infinity;

  /**
   * Notes that a segment with a duration of `lengthMs` was fetched from `beganMs` until `nowMs`.
   * @param {number} beganMs @param {number} nowMs @param {number} lengthMs
   */
  fetched(beganMs, nowMs, lengthMs) {
    const tookMs = nowMs - beganMs;
    this.#tookMs = tookMs;
    const restMs = Math.min(REST_SHARE * tookMs, Math.max(0, GROWTH_SHARE * lengthMs - tookMs));
    this.#restsUntilMs = nowMs + restMs;
  }

  /** Whether to fetch a segment now that is due in `dueMs`. @param {number} dueMs @param {number} nowMs */
  allows(dueMs, nowMs) {
    return nowMs >= this.#restsUntilMs || dueMs < URGENT_MS + 2 * this.#tookMs;
  }
}

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
   * @param {SoundSource} source @param {Timeline} timeline
   * @param {(segment: number, part: string, signal: AbortSignal) => Promise<Uint8Array>} fetchObject
   * @param {(file: ArrayBuffer) => Promise<AudioBuffer>} decode at 48000 Hz
   * @param {(error: unknown) => void} refused called with the error of a refused object
   */
  constructor(source, timeline, fetchObject, decode, refused) {
    /** @type {SoundSource} */ this.source = source;
    /** @type {Timeline} */ this.timeline = timeline;
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
   * @param {Piece[]} pieces @param {number} numDecoded number of first pieces that are also decoded
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

  /** @param {Piece} piece @param {SoundObject} object */
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
   * @param {Float32Array[]} samples @param {number} begin @param {number} end @param {SoundObject} object
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
