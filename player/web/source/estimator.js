/** Busy seconds after which what was seen counts half. */
const HALF_LIFE_S = 0.4;
/** Nothing is estimated from less. */
const LEAST_BYTES = 16 * 1024;

/** How fast a connection carries bytes: bytes over busy time, the last ones counting most. */
export class RateEstimator {
  constructor() {
    /** @type {number | null} bits per second; null until enough has come */
    this.rateBps = null;
    this.bytes = 0;
    this.busyS = 0;
  }

  /**
   * Takes in that bytes came while something was on its way for `busyS` seconds.
   * @param {number} bytes
   * @param {number} busyS
   */
  add(bytes, busyS) {
    const kept = 0.5 ** (busyS / HALF_LIFE_S);
    this.bytes = kept * this.bytes + bytes;
    this.busyS = kept * this.busyS + busyS;
    if (this.rateBps === null && this.bytes < LEAST_BYTES) return;
    if (this.busyS > 0) this.rateBps = Math.max(1, (8 * this.bytes) / this.busyS);
  }
}
