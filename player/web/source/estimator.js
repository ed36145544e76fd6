/** Busy seconds after which a measurement counts half. */
const HALF_LIFE_S = 0.4;
/** Minimum amount of data for an estimate. */
const LEAST_BYTES = 16 * 1024;
/** Sooner answers come from a cache, or from a host so near that the round trip does not matter. */
const LEAST_ROUND_TRIP_S = 0.02;
/** Requests under way at a time: what a browser sends at once over HTTP/1.1, and what HTTP/2 takes. */
const LEAST_REQUESTS = 6;
/** Over HTTP/2 they come back at once, and more may follow soon. */
const FIRST_REQUESTS = 9;
const MOST_REQUESTS = 100;
/** A first byte that takes so many round trips has waited for other requests. */
const QUICK_ROUND_TRIPS = 1.5;
/** Weight of one more request in the mean time to a first byte. */
const WEIGHT = 1 / 4;

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

/**
 * How far away a host is, and how many requests it answers side by side. More of them would wait in the
 * browser, where what has been chosen too early cannot be chosen again; so their number grows only while
 * first bytes come quickly.
 */
export class RequestWindow {
  /** Least time to a first byte, seconds. */
  roundTripS = Infinity;
  /** Mean of late, seconds. */
  waitS = 0;
  /** Requests that may be under way. */
  mostRequests = FIRST_REQUESTS;

  /** @param {number} tookS seconds from a request to its first byte */
  addFirstByte(tookS) {
    if (tookS > LEAST_ROUND_TRIP_S) this.roundTripS = Math.min(this.roundTripS, tookS);
    this.waitS += WEIGHT * (tookS - this.waitS);
    const isQuick = tookS < QUICK_ROUND_TRIPS * this.roundTripS;
    const most = this.mostRequests + (isQuick ? 1 : -1);
    this.mostRequests = Math.min(Math.max(most, LEAST_REQUESTS), MOST_REQUESTS);
  }
}
