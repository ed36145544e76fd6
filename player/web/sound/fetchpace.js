/** After a segment that was fetched ahead the link belongs to the pictures, for so many times as long as it took. */
const REST_SHARE = 4;
/** Together they take this share of what the segment lasts at most: the lead of the sound always grows. */
const GROWTH_SHARE = 0.8;
/** Without such a rest comes what is heard in less than this and twice as long as the one before took. */
const URGENT_MS = 300;

/**
 * When the link is for the next segment of sound, and when for the pictures alone. The pictures share it
 * with whatever is fetched beside them: where it carries little more than layer 0, many seconds of sound
 * at once would stall them, and the sound with them.
 */
export class FetchPace {
  #tookMs = 0;
  #restsUntilMs = -Infinity;

  /**
   * A segment that is heard for `lengthMs` took from `beganMs` until now.
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
   * Whether a segment that is heard in `dueMs` is to be fetched now.
   * @param {number} dueMs
   * @param {number} nowMs
   */
  allows(dueMs, nowMs) {
    return nowMs >= this.#restsUntilMs || dueMs < URGENT_MS + 2 * this.#tookMs;
  }
}
