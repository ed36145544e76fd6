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
    /** Whether enough bytes of the connection have arrived. */
    this.isKnown = false;
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
    this.isKnown ||= this.bytes >= LEAST_BYTES;
    if (this.isKnown && this.busyS > 0) this.rateBps = Math.max(1, (8 * this.bytes) / this.busyS);
  }

  /**
   * Takes the weight of bytes that did not cross the connection. The rate stays until others have come: the
   * rest of what is cached arrives as fast.
   * @param {number} bytes
   */
  remove(bytes) {
    const kept = Math.max(0, 1 - bytes / Math.max(1, this.bytes));
    this.bytes *= kept;
    this.busyS *= kept;
    this.isKnown = this.bytes >= LEAST_BYTES;
  }
}

/**
 * Reports the responses whose bodies came from the browser's cache. Those of another origin are known only
 * if its host sends `Timing-Allow-Origin`.
 * @param {(numBytes: number) => void} onCached
 */
export function watchCache(onCached) {
  new PerformanceObserver((list) => {
    for (const entry of list.getEntries()) {
      const { transferSize, encodedBodySize } = /** @type {PerformanceResourceTiming} */ (entry);
      if (transferSize < encodedBodySize) onCached(encodedBodySize);
    }
  }).observe({ type: "resource" });
}
