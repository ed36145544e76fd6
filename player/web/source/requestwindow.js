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
