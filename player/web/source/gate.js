const FIRST_DELAY_S = 0.25;
/** Well below the buffered time, so that a returning network is noticed before playback stalls. */
const LONGEST_DELAY_S = 1;

/** Seconds to wait after try number `tries`. @param {number} tries from 1 on */
export function delayS(tries) {
  const mostS = Math.min(LONGEST_DELAY_S, FIRST_DELAY_S * 2 ** (tries - 1));
  // Random, so that clients that lost a server together do not return all at once.
  return mostS * (0.5 + 0.5 * Math.random());
}

/** @param {number} seconds */
export const rest = (seconds) => new Promise((resolve) => setTimeout(resolve, 1000 * seconds));

/**
 * What all requests to a host pass: freely while they are answered, and one at a time, with growing delays,
 * while the network is gone.
 */
export class Gate {
  /** Number of tries in a row that were not answered. */
  #tries = 0;
  /** The earliest time of the next try. */
  #openMs = 0;
  /** @type {Promise<void> | null} resolves when the trial that is under way has ended */
  #trial = null;
  #endTrial = () => {};

  /**
   * Resolves when the caller may send a request; `leave` must follow.
   * @returns {Promise<boolean>} whether it is a trial: the only request until it is answered
   */
  async enter() {
    while (this.#trial !== null) await this.#trial;
    if (this.#tries === 0) return false;
    this.#trial = new Promise((resolve) => (this.#endTrial = resolve));
    await rest(Math.max(0, this.#openMs - performance.now()) / 1000);
    return true;
  }

  /**
   * To be called when a request that has entered is answered or has failed.
   * @param {boolean} isTrial what `enter` gave
   * @param {boolean | null} isAnswered null: the caller has given it up
   */
  leave(isTrial, isAnswered) {
    if (isAnswered) this.#tries = 0;
    // The first of the requests that were under way when the network went closes the gate.
    else if (isAnswered === false && (isTrial || this.#tries === 0)) {
      this.#tries += 1;
      this.#openMs = performance.now() + 1000 * delayS(this.#tries);
    }
    if (!isTrial) return;
    this.#trial = null;
    this.#endTrial();
  }
}
