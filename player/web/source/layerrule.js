import { skipMapsOf, keyframeOf } from "../format/manifest.js";

/** @typedef {import("../format/manifest.js").Part} Part */

/** Parameters of the plan for a static host; bench/network/hosted.py measures them. */
const PLAN = {
  /** Share of the estimated throughput that is planned with. */
  safety: 0.9,
  /** Seconds of layer 0 that are requested before other layers. */
  baseS: 9,
  /** The same at the beginning, if the link carries much more than layer 0. */
  leastBaseS: 3,
  /** Seconds by which it grows in a second of the stream, beside the layers that show already. */
  baseGrowth: 2,
  /** Maximum seconds of layer 0 ahead. */
  mostS: 15,
  /** Share of a segment's duration by which a layer above 0 may arrive late. */
  lateShare: 0.5,
  /** A layer is started if the link carries this share of it and the layers below. */
  riseShare: 0.8,
};

/**
 * The current state of the playback and its link.
 * @typedef {object} PlaybackState
 * @property {number} nextFrame the frame that shows next
 * @property {boolean} paused
 * @property {number} rateBps estimated throughput of the link
 * @property {number} queuedBytes requested, but not received
 * @property {number} waitS seconds from a request to its first byte
 * @property {number} rate playback rate; 1 is normal speed
 */

/**
 * Whether an object has been received already.
 * @typedef {(record: import("../format/objects.js").SegmentRecord, part: Part) => boolean} IsHere
 */

/**
 * Decides which objects of a static host are fetched, and in which order: layer 0 some seconds ahead, then further
 * layers of the segments ahead, one after another, as far as the link delivers them in time, then more of layer 0.
 */
export class LayerRule {
  /**
   * @param {import("../format/manifest.js").Manifest} manifest
   * @param {import("../format/objects.js").SegmentRecord[]} records of all segments; may grow
   * @param {number} firstFrame @param {number} mostLayers @param {IsHere} [isHere]
   */
  constructor(manifest, records, firstFrame, mostLayers, isHere = () => false) {
    /** @type {IsHere} */ this.isHere = isHere;
    this.manifest = manifest;
    this.records = records;
    /** @type {number} */ this.mostLayers = mostLayers;
    /** @type {number} */ this.first = this.#segmentOf(firstFrame);
    /** @type {Map<number, number>} by segment, the number of its layers that were requested */
    this.levels = new Map();
    /** @type {Set<string>} layers that segments lack, although they were requested: segment and layer */
    this.lost = new Set();
  }

  /**
   * The segment for which one more layer should be requested now; null if there is none.
   * @param {PlaybackState} state
   */
  choose({ nextFrame, paused, rateBps, queuedBytes, waitS, rate }) {
    const { fps, segmentFrames } = this.manifest;
    const current = Math.max(this.first, this.#segmentOf(nextFrame));
    for (const known of this.levels.keys()) if (known < current - 1) this.levels.delete(known);
    for (const name of this.lost) if (parseInt(name, 10) < current - 1) this.lost.delete(name);
    const startS = (/** @type {number} */ segment) => (segment * segmentFrames - nextFrame) / fps;
    let base = current;
    while (this.#level(base) > 0) base += 1;
    const wantsBase = base < this.records.length && startS(base) < PLAN.mostS;
    // A still picture gets all layers first, however long they take.
    const isStill = paused && base > current && this.#level(current) < this.mostLayers;
    if (isStill) return current;
    const plannedBps = (PLAN.safety * rateBps) / rate; // per second of the stream
    const playedS = Math.max(0, -startS(this.first) - PLAN.leastBaseS);
    const baseS = (wantsBase ? this.#baseS(base, plannedBps) : 0) + PLAN.baseGrowth * playedS;
    if (wantsBase && startS(base) < Math.min(baseS, PLAN.baseS)) return base;
    const lateS = (PLAN.lateShare * segmentFrames) / fps;
    for (let layer = 1; layer < this.mostLayers; layer++) {
      for (let segment = current; segment < base; segment++) {
        if (this.#level(segment) !== layer) continue;
        const missingBytes = this.bytes(segment, this.parts(segment));
        if (missingBytes === 0) return segment;
        const beginsS = Math.max(waitS, (8 * queuedBytes) / plannedBps);
        const comesS = beginsS + (8 * missingBytes) / plannedBps;
        if (!paused && comesS > startS(segment) + lateS) continue;
        if (this.#follows(segment) || this.#carries(segment, plannedBps)) return segment;
      }
    }
    return wantsBase ? base : null;
  }

  /** Whether layer 0 was requested up to the last segment. */
  get isAtEnd() {
    return this.#level(this.records.length - 1) > 0;
  }

  /**
   * The missing parts of a segment's next layer. A layer that the previous segment lacks begins with its keyframe.
   * @param {number} segment
   */
  parts(segment) {
    const layer = this.#level(segment);
    const parts = layer === 0 ? [skipMapsOf(this.manifest), layer] : [layer];
    if (!this.#follows(segment)) parts.unshift(keyframeOf(this.manifest, layer));
    return parts.filter((part) => !this.isHere(this.records[segment], part));
  }

  /** Whether the next layer of a segment continues the previous segment's. @param {number} segment */
  #follows(segment) {
    const layer = this.#level(segment);
    const isThere = this.#level(segment - 1) > layer && !this.lost.has(`${segment - 1}/${layer}`);
    return segment !== this.first && isThere;
  }

  /**
   * Notes that a segment lacks a layer that was requested; returns the part of the next segment that is
   * needed for this, if that segment was requested already.
   * @param {number} segment @param {number} layer
   */
  lose(segment, layer) {
    this.lost.add(`${segment}/${layer}`);
    const part = keyframeOf(this.manifest, layer);
    const isLate = this.#level(segment + 1) > layer;
    return isLate && !this.isHere(this.records[segment + 1], part) ? part : null;
  }

  /** Size of some parts of a segment. @param {number} segment @param {Part[]} parts */
  bytes(segment, parts) {
    const { objectBytes } = this.records[segment];
    return parts.reduce((sum, part) => sum + objectBytes[part], 0);
  }

  /** Notes that one more layer of a segment was requested. @param {number} segment */
  add(segment) {
    this.levels.set(segment, this.#level(segment) + 1);
  }

  /**
   * Whether the link carries one more layer, from the given segment on.
   * @param {number} segment @param {number} plannedBps
   */
  #carries(segment, plannedBps) {
    return PLAN.riseShare * this.#needBps(segment, this.#level(segment) + 1) <= plannedBps;
  }

  /**
   * Seconds of layer 0 that are requested before other layers; fewer if twice its rate is a small share of
   * the link, as it can be fetched soon then.
   * @param {number} segment @param {number} plannedBps
   */
  #baseS(segment, plannedBps) {
    const share = Math.min(1, (2 * this.#needBps(segment, 1)) / plannedBps);
    return Math.max(PLAN.leastBaseS, PLAN.baseS * share ** 2);
  }

  /**
   * Bits per second of the stream that some layers of a segment need.
   * @param {number} segment @param {number} numLayers
   */
  #needBps(segment, numLayers) {
    const layers = [...Array(numLayers).keys()];
    const bits = 8 * this.bytes(segment, [skipMapsOf(this.manifest), ...layers]);
    return (bits * this.manifest.fps) / this.records[segment].numFrames;
  }

  /** @param {number} frame */
  #segmentOf(frame) {
    return Math.floor(frame / this.manifest.segmentFrames);
  }

  /** @param {number} segment */
  #level(segment) {
    return this.levels.get(segment) ?? 0;
  }
}
