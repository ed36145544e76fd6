/** What a play of a static host plans with; bench/network/hosted.py measures it. */
const PLAN = {
  /** Share of the estimated rate. */
  safety: 0.9,
  /** Seconds of layer 0 that are there before other layers are asked for. */
  baseS: 9,
  /** Seconds of layer 0 at most. */
  mostS: 15,
  /** Part of a segment by which another layer of it may come late. */
  lateShare: 0.5,
  /** A layer is taken up if the link carries this share of it and of those before it. */
  riseShare: 0.8,
};

/**
 * The playback and its link at one moment.
 * @typedef {object} PlaybackState
 * @property {number} nextFrame the frame that shows next
 * @property {boolean} paused
 * @property {number} rateBps what the link is taken to carry
 * @property {number} queuedBytes asked for, but not here
 * @property {number} rate seconds of the stream that show in a second
 */

/**
 * Whether an object is here already.
 * @typedef {(record: import("../format/streamindex.js").SegmentRecord, part: string) => boolean} IsHere
 */

/**
 * Which objects of a static host are fetched in which order: layer 0 some seconds ahead, then one
 * layer after another of what is ahead, as far as the link brings it in time, then more of layer 0.
 */
export class LayerRule {
  /**
   * @param {import("../format/manifest.js").Manifest} manifest
   * @param {import("../format/streamindex.js").SegmentRecord[]} records of all segments; may grow
   * @param {number} firstFrame
   * @param {number} mostLayers
   * @param {IsHere} [isHere]
   */
  constructor(manifest, records, firstFrame, mostLayers, isHere = () => false) {
    this.isHere = isHere;
    this.manifest = manifest;
    this.records = records;
    this.mostLayers = mostLayers;
    this.first = this.#segmentOf(firstFrame);
    /** @type {Map<number, number>} by segment, how many of its layers were asked for */
    this.levels = new Map();
  }

  /**
   * The segment that gets one more layer now; null if none is worth it.
   * @param {PlaybackState} standing
   */
  choose({ nextFrame, paused, rateBps, queuedBytes, rate }) {
    const { fps, segmentFrames } = this.manifest;
    const current = Math.max(this.first, this.#segmentOf(nextFrame));
    for (const known of this.levels.keys()) if (known < current - 1) this.levels.delete(known);
    const startS = (/** @type {number} */ segment) => (segment * segmentFrames - nextFrame) / fps;
    let base = current;
    while (this.#level(base) > 0) base += 1;
    const wantsBase = base < this.records.length && startS(base) < PLAN.mostS;
    // A still picture gets all layers first, however long they take.
    const isStill = paused && base > current && this.#level(current) < this.mostLayers;
    if (isStill) return current;
    if (wantsBase && startS(base) < PLAN.baseS) return base;
    const plannedBps = (PLAN.safety * rateBps) / rate; // in time of the stream
    const lateS = (PLAN.lateShare * segmentFrames) / fps;
    for (let layer = 1; layer < this.mostLayers; layer++) {
      for (let segment = current; segment < base; segment++) {
        if (this.#level(segment) !== layer) continue;
        const missingBytes = this.bytes(segment, this.parts(segment));
        if (missingBytes === 0) return segment;
        const comesS = (8 * (queuedBytes + missingBytes)) / plannedBps;
        if (!paused && comesS > startS(segment) + lateS) continue;
        if (this.#follows(segment) || this.#carries(segment, plannedBps)) return segment;
      }
    }
    return wantsBase ? base : null;
  }

  /** Whether every segment up to the last one has its layer 0, or it was asked for. */
  get isAtEnd() {
    return this.#level(this.records.length - 1) > 0;
  }

  /**
   * The parts that bring the next layer of a segment, and are not here. One that the segment before
   * does not have begins with its snapshot.
   * @param {number} segment
   */
  parts(segment) {
    const layer = this.#level(segment);
    const parts = layer === 0 ? ["masks", "0"] : [`${layer}`];
    if (!this.#follows(segment)) parts.unshift(`snapshot-${layer}`);
    return parts.filter((part) => !this.isHere(this.records[segment], part));
  }

  /** Whether the next layer of a segment continues that of the segment before. @param {number} segment */
  #follows(segment) {
    return segment !== this.first && this.#level(segment - 1) > this.#level(segment);
  }

  /**
   * What parts of a segment take.
   * @param {number} segment
   * @param {string[]} parts
   */
  bytes(segment, parts) {
    const { objectBytes } = this.records[segment];
    return parts.reduce((sum, part) => sum + objectBytes[this.manifest.parts.indexOf(part)], 0);
  }

  /** One more layer of a segment was asked for. @param {number} segment */
  add(segment) {
    this.levels.set(segment, this.#level(segment) + 1);
  }

  /**
   * Whether a link carries one more layer from a segment on.
   * @param {number} segment
   * @param {number} plannedBps
   */
  #carries(segment, plannedBps) {
    const layers = Array.from({ length: this.#level(segment) + 1 }, (_, layer) => `${layer}`);
    const bits = 8 * this.bytes(segment, ["masks", ...layers]);
    const { numFrames } = this.records[segment];
    return PLAN.riseShare * bits * this.manifest.fps <= plannedBps * numFrames;
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
