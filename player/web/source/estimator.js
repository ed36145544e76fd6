/** Busy seconds after which a measurement counts half. */
const HALF_LIFE_S = 0.4;
/** Minimum amount of data for an estimate. */
const LEAST_BYTES = 16 * 1024;

/** Estimates a connection's throughput: bytes over busy time, with exponentially decaying weights. */
export class RateEstimator {
  constructor() {
    /** @type {number | null} bits per second; null until enough data has arrived */
    this.rateBps = null;
    this.bytes = 0;
    this.busyS = 0;
  }

  /**
   * Adds the bytes that arrived during `busyS` seconds with data in flight.
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
