/**
 * Ranges of time in seconds, ascending and disjoint, like `TimeRanges` of HTML, which a script cannot
 * construct.
 * @implements {TimeRanges}
 */
export class SecondRanges {
  #ranges;

  /** @param {[startS: number, endS: number][]} ranges */
  constructor(ranges) {
    this.#ranges = ranges;
  }

  get length() {
    return this.#ranges.length;
  }

  /** Seconds. Throws an IndexSizeError. @param {number} index */
  start(index) {
    return this.#at(index)[0];
  }

  /** Seconds. Throws an IndexSizeError. @param {number} index */
  end(index) {
    return this.#at(index)[1];
  }

  /** @param {number} index */
  #at(index) {
    const range = this.#ranges[index];
    if (range === undefined) {
      const message = `there is no range ${index} of ${this.length}`;
      throw new DOMException(message, "IndexSizeError");
    }
    return range;
  }
}

/** A set of frames, kept as ascending, disjoint ranges. */
export class FrameRanges {
  /** @type {[firstFrame: number, endFrame: number][]} */
  ranges = [];

  /**
   * Adds the frames [firstFrame, endFrame).
   * @param {number} firstFrame
   * @param {number} endFrame
   */
  add(firstFrame, endFrame) {
    if (endFrame <= firstFrame) return;
    const before = this.ranges.filter(([, end]) => end < firstFrame);
    const after = this.ranges.filter(([first]) => first > endFrame);
    const touched = this.ranges.slice(before.length, this.ranges.length - after.length);
    const first = Math.min(firstFrame, ...touched.map((range) => range[0]));
    const end = Math.max(endFrame, ...touched.map((range) => range[1]));
    this.ranges = [...before, [first, end], ...after];
  }

  /** The ranges in seconds. @param {number} fps */
  inSeconds(fps) {
    return new SecondRanges(this.ranges.map(([first, end]) => [first / fps, end / fps]));
  }
}
