/**
 * What a client holds of a stream of version 1, or will hold when all that is underway has come: a
 * slice shows for swinSize frames, whatever the others have (server/abr/holding.py).
 */
export class SliceHolding {
  /**
   * @param {import("./media.js").Media} media
   * @param {number} firstFrame
   */
  constructor(media, firstFrame) {
    this.media = media;
    this.firstFrame = firstFrame;
    this.firstBirth = firstFrame - media.swinSize + 1;
    /** @type {Map<number, number>} */
    this.levels = new Map();
    /** @type {Map<number, [number, number][]>} layers that came before those under them */
    this.early = new Map();
    this.endBirth = this.firstBirth;
  }

  /** The first frame that cannot show. */
  get endFrame() {
    return Math.max(this.endBirth, this.firstFrame);
  }

  /** How many layers of the slice are here, from layer 0 on. @param {number} birth */
  level(birth) {
    return this.levels.get(birth) ?? 0;
  }

  /**
   * Adds the packets of layers firstLayer .. endLayer - 1 of a slice.
   * @param {number} birth
   * @param {number} firstLayer
   * @param {number} endLayer
   */
  add(birth, firstLayer, endLayer) {
    let level = this.level(birth);
    const early = this.early.get(birth) ?? [];
    if (firstLayer > level) {
      this.early.set(birth, [...early, [firstLayer, endLayer]]);
      return;
    }
    level = Math.max(level, endLayer);
    for (const [first, end] of early.sort(([a, b], [c, d]) => a - c || b - d)) {
      if (first <= level) level = Math.max(level, end);
    }
    this.levels.set(birth, level);
    while (this.level(this.endBirth) >= 1) this.endBirth += 1;
  }

  /** @returns {never} */
  addSnapshots() {
    throw new TypeError("a stream of whole slices has no snapshots");
  }

  /** Frames before `frame` are not asked for any more. @param {number} frame */
  forget(frame) {
    const oldest = frame - this.media.swinSize + 1;
    for (const birth of this.levels.keys()) {
      if (birth < oldest && birth < this.endBirth) {
        this.levels.delete(birth);
        this.early.delete(birth);
      }
    }
  }

  /**
   * Whether all layers are here of all that is born in frame .. endFrame - 1.
   * @param {number} frame
   * @param {number} endFrame
   */
  isComplete(frame, endFrame) {
    for (let birth = frame; birth < endFrame; birth++) {
      if (this.level(birth) !== this.media.numLayers) return false;
    }
    return true;
  }
}
