/** A clock that differs by more has jumped. */
const JUMP_S = 0.05;
const SHARE = 0.1;

/**
 * When what is scheduled in an AudioContext is heard: its clock against that of the page. The device
 * reports that unevenly, so it is averaged.
 */
export class AudioClock {
  /** @type {number | null} seconds of the context less those of the page, of what is heard now */
  offsetS = null;

  /** @param {AudioContext} context */
  constructor(context) {
    this.context = context;
  }

  /** Looks at both clocks. */
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
