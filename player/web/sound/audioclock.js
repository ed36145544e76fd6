/** A larger difference between the clocks counts as a jump. */
const JUMP_S = 0.05;
const SHARE = 0.1;

/**
 * Relates the clock of an AudioContext, as heard, to that of the page. The device's reports are uneven, so
 * they are averaged.
 */
export class AudioClock {
  /** @type {number | null} context time of the sound heard now, minus the page's time, seconds */
  offsetS = null;

  /** @param {AudioContext} context */
  constructor(context) {
    this.context = context;
  }

  /** Reads both clocks, and updates the offset. */
  look() {
    const foundS = this.#found();
    const differS = foundS - (this.offsetS ?? Infinity);
    if (!(Math.abs(differS) < JUMP_S)) this.offsetS = foundS;
    else this.offsetS = (this.offsetS ?? foundS) + SHARE * differS;
  }

  #found() {
    const { context } = this;
    const { contextTime, performanceTime } = context.getOutputTimestamp?.() ?? {};
    if (contextTime && performanceTime) return contextTime - performanceTime / 1000;
    const latencyS = context.outputLatency || context.baseLatency || 0;
    return context.currentTime - latencyS - performance.now() / 1000;
  }
}
