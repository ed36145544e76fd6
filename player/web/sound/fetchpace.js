/** After a segment was fetched, the link is left to the pictures for this multiple of its fetch time. */
const REST_SHARE = 4;
/** Fetch and rest take at most this share of the segment's duration, so that the lead of the sound grows. */
const GROWTH_SHARE = 0.8;
/** A segment due in less than this plus twice the last fetch time is fetched without waiting for the rest. */
const URGENT_MS = 300;

/**
 * Decides when the next segment of sound may be fetched, and when the link is left to the pictures. If
 * the link carries little more than layer 0, fetching many seconds of sound at once would stall the
 * pictures, and with them the sound.
 */
export class FetchPace {
  #tookMs = 0;
  #restsUntilMs = -Infinity;

  /**
   * Notes that a segment with a duration of `lengthMs` was fetched from `beganMs` until `nowMs`.
   * @param {number} beganMs
   * @param {number} nowMs
   * @param {number} lengthMs
   */
  fetched(beganMs, nowMs, lengthMs) {
    const tookMs = nowMs - beganMs;
    this.#tookMs = tookMs;
    const restMs = Math.min(REST_SHARE * tookMs, Math.max(0, GROWTH_SHARE * lengthMs - tookMs));
    this.#restsUntilMs = nowMs + restMs;
  }

  /**
   * Whether to fetch a segment now that is due in `dueMs`.
   * @param {number} dueMs
   * @param {number} nowMs
   */
  allows(dueMs, nowMs) {
    return nowMs >= this.#restsUntilMs || dueMs < URGENT_MS + 2 * this.#tookMs;
  }
}
