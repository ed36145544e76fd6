import { isKeyframe, skipMapsOf, keyframeOf } from "../format/manifest.js";

/** Limit of the cache unless a page sets another one. */
const DEFAULT_BUFFER_BYTES = 64e6;

/** Memory of a packet in addition to its own bytes. */
const PACKET_OVERHEAD_BYTES = 128;

/** Segments that begin to show within this many seconds are not evicted. */
export const AHEAD_S = 20;

/** @typedef {import("../format/manifest.js").Part} Part */

/**
 * The received packets of one part of a segment, by frame from its first one on; a keyframe has one packet.
 * @typedef {(Uint8Array | null)[]} Row
 */

/** @typedef {{ numBytes: number, rows: Row[] }} HeldSegment */

/**
 * Called for each new packet in a cache.
 * @typedef {(birth: number, part: Part, packet: Uint8Array) => void} PacketListener
 */

/**
 * The received packets of a stream, in coded form. The cache holds at most `limitBytes`, or more if the
 * segments that play next need it; sources request those only while `hasRoomFor` allows it. Loops, seeks
 * and steps read from the cache.
 *
 * An empty packet means that nothing changes; a missing packet is null.
 */
export class SegmentCache {
  numBytes = 0;
  /** @type {Map<number, HeldSegment>} the least recently used first */
  segments = new Map();
  /** @type {Set<PacketListener>} */
  listeners = new Set();
  playhead = 0;
  /** @type {number | null} number of segments of the stream if it loops; otherwise null */
  loopSegments = null;

  /** @param {import("../format/manifest.js").Manifest} manifest @param {number} limitBytes */
  constructor({ segmentFrames, numLayers, fps }, limitBytes = DEFAULT_BUFFER_BYTES) {
    /** @type {number} */ this.segmentFrames = segmentFrames;
    /** @type {number} */ this.numLayers = numLayers;
    /** @type {number} */ this.fps = fps;
    /** @type {number} */ this.limitBytes = limitBytes;
    /** @type {number} */ this.aheadSegments = Math.ceil((AHEAD_S * fps) / segmentFrames);
  }

  /**
   * Sets which segments play next.
   * @param {number} frame the one that shows next
   * @param {number | null} loopFrames length of the stream if it plays in a loop
   */
  setPlayhead(frame, loopFrames) {
    this.playhead = this.segmentOf(Math.max(0, frame));
    this.loopSegments = loopFrames === null ? null : Math.ceil(loopFrames / this.segmentFrames);
    const shown = this.segments.get(this.playhead);
    if (shown === undefined) return;
    this.segments.delete(this.playhead);
    this.segments.set(this.playhead, shown);
  }

  /** @param {number} frame */
  segmentOf(frame) {
    return Math.floor(frame / this.segmentFrames);
  }

  /**
   * Adds a packet, unless it is here.
   * @param {number} birth any frame of the segment for a keyframe @param {Part} part
   * @param {Uint8Array} packet
   */
  add(birth, part, packet) {
    const held = this.#hold(birth);
    const row = held.rows[part];
    const at = birth % row.length;
    if (row[at] !== null) return;
    row[at] = packet;
    const numBytes = PACKET_OVERHEAD_BYTES + packet.length;
    held.numBytes += numBytes;
    this.numBytes += numBytes;
    for (const listener of this.listeners) listener(birth, part, packet);
    while (this.numBytes > this.limitBytes && this.#evictOne(this.segmentOf(birth)));
  }

  /** @param {number} birth any frame of the segment for a keyframe @param {Part} part */
  packet(birth, part) {
    const row = birth < 0 ? null : this.#row(this.segmentOf(birth), part);
    return row?.[birth % row.length] ?? null;
  }

  /** @param {number} segment @param {number} layer */
  keyframe(segment, layer) {
    return this.#row(segment, keyframeOf(this, layer))?.[0] ?? null;
  }

  /** Whether the skip map and layer 0 of a slice are cached. @param {number} birth */
  hasSlice(birth) {
    return this.packet(birth, skipMapsOf(this)) !== null && this.packet(birth, 0) !== null;
  }

  /** Whether layer 0 of a frame is cached, assuming that the previous frame is. @param {number} frame */
  hasFrame(frame) {
    const isFirst = frame % this.segmentFrames === 0;
    return this.hasSlice(frame) || (isFirst && this.keyframe(this.segmentOf(frame), 0) !== null);
  }

  /**
   * Whether a segment can continue the previous one with all of these layers; its first frame comes from
   * changes or from keyframes.
   * @param {number} segment @param {number} numFrames of the segment @param {number} numLayers
   */
  isComplete(segment, numFrames, numLayers) {
    if (!this.hasAllChanges(segment, numFrames, numLayers)) return false;
    const first = segment * this.segmentFrames;
    const missing = this.missingKeyframes(segment, numLayers);
    const parts = missing.length > 0 ? [skipMapsOf(this), ...missing] : [];
    return parts.every((part) => this.packet(first, part) !== null);
  }

  /**
   * Whether all slices of a segment after its first one are cached.
   * @param {number} segment @param {number} numFrames of the segment @param {number} numLayers
   */
  hasAllChanges(segment, numFrames, numLayers) {
    const held = this.segments.get(segment);
    if (held === undefined || !isWhole(held.rows[skipMapsOf(this)], 1, numFrames)) return false;
    return held.rows.slice(0, numLayers).every((row) => isWhole(row, 1, numFrames));
  }

  /** The layers whose keyframe is missing. @param {number} segment @param {number} numLayers */
  missingKeyframes(segment, numLayers) {
    const layers = [...Array(numLayers).keys()];
    return layers.filter((layer) => this.keyframe(segment, layer) === null);
  }

  /** The first missing frame from `frame` on. @param {number} frame @param {number} numFrames */
  endOf(frame, numFrames) {
    let end = frame;
    while (end < numFrames && this.hasFrame(end)) end += 1;
    return end;
  }

  /** The cached frames, as [first, end) pairs in order. @param {number} numFrames @returns {[number, number][]} */
  ranges(numFrames) {
    /** @type {[number, number][]} */
    const found = [];
    for (const segment of [...this.segments.keys()].sort((a, b) => a - b)) {
      const endFrame = Math.min(numFrames, (segment + 1) * this.segmentFrames);
      for (let frame = segment * this.segmentFrames; frame < endFrame; frame++) {
        if (!this.hasFrame(frame)) continue;
        const last = found.at(-1);
        if (last !== undefined && last[1] === frame) last[1] = frame + 1;
        else found.push([frame, frame + 1]);
      }
    }
    return found;
  }

  /**
   * Bits per second that skip maps and layer 0 of the segment of a frame take; 0 if none of it is cached.
   * @param {number} frame
   */
  baseBps(frame) {
    const segment = this.segmentOf(frame);
    const base = this.#row(segment, 0) ?? [];
    const skipMaps = this.#row(segment, skipMapsOf(this)) ?? [];
    const numFrames = base.filter((packet) => packet !== null).length;
    const numBytes = [...skipMaps, ...base].reduce((sum, packet) => sum + (packet?.length ?? 0), 0);
    return numFrames && (8 * numBytes * this.fps) / numFrames;
  }

  /**
   * Whether a segment should be requested, because the segments that play before it leave room.
   * @param {number} segment
   */
  hasRoomFor(segment) {
    const distance = this.#distance(segment);
    if (distance <= 1) return true;
    let keptBytes = 0;
    for (const [known, { numBytes }] of this.segments)
      if (this.#distance(known) < distance) keptBytes += numBytes;
    return keptBytes < this.limitBytes;
  }

  /** @param {number} segment @param {Part} part */
  #row(segment, part) {
    return this.segments.get(segment)?.rows[part] ?? null;
  }

  /** @param {number} birth */
  #hold(birth) {
    const segment = this.segmentOf(birth);
    let held = this.segments.get(segment);
    if (held === undefined) {
      const row = (/** @type {unknown} */ _, /** @type {Part} */ part) =>
        new Array(isKeyframe(this, part) ? 1 : this.segmentFrames).fill(null);
      held = { numBytes: 0, rows: Array.from({ length: 2 * this.numLayers + 1 }, row) };
      this.segments.set(segment, held);
    }
    return held;
  }

  /**
   * Evicts the segment that is needed last; returns whether there was one.
   * @param {number} newest the segment that was just added to; it is not evicted
   */
  #evictOne(newest) {
    let victim = -1;
    let farthest = -1;
    const isLoop = this.loopSegments !== null;
    for (const segment of this.segments.keys()) {
      const distance = this.#distance(segment);
      if (segment === newest || distance <= (isLoop ? 1 : this.aheadSegments)) continue;
      // Without a loop it is unknown what plays again; the first one, least recently used, is evicted.
      const rank = isLoop ? distance : 0;
      if (rank <= farthest) continue;
      farthest = rank;
      victim = segment;
    }
    if (victim < 0) return false;
    this.numBytes -= this.segments.get(victim)?.numBytes ?? 0;
    this.segments.delete(victim);
    return true;
  }

  /** Number of segments until this one plays; Infinity if that needs a seek. @param {number} segment */
  #distance(segment) {
    if (segment >= this.playhead) return segment - this.playhead;
    return this.loopSegments === null ? Infinity : segment + this.loopSegments - this.playhead;
  }
}

/** @param {Row} row @param {number} first @param {number} end */
export function isWhole(row, first, end) {
  for (let at = first; at < end; at++) if (row[at] === null) return false;
  return true;
}
