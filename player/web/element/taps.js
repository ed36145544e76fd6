const TAP_MS = 250;
const TAP_PX = 12;
const PAUSE_MS = 300;
const APART_PX = 40;

/**
 * The part of a touch event that tap detection uses.
 * @typedef {object} Touched
 * @property {number} clientX
 * @property {number} clientY
 * @property {number} timeStamp ms
 */

/** Detects double taps of one finger. */
export class Taps {
  /** @type {Touched | null} */
  #down = null;
  /** @type {Touched | null} the tap before */
  #last = null;

  /** Handles a finger that touches. @param {Touched} event @param {number} numFingers */
  down({ clientX, clientY, timeStamp }, numFingers) {
    this.#down = numFingers === 1 ? { clientX, clientY, timeStamp } : null;
  }

  /** Handles a lifted finger. @param {Touched} event @returns {boolean} whether that was a double tap */
  up({ clientX, clientY, timeStamp }) {
    const up = { clientX, clientY, timeStamp };
    const isTap = isNear(this.#down, up, TAP_MS, TAP_PX);
    const isDouble = isTap && isNear(this.#last, up, PAUSE_MS + TAP_MS, APART_PX);
    this.#last = isTap && !isDouble ? up : null;
    return isDouble;
  }
}

/**
 * @param {Touched | null} first
 * @param {Touched} second
 * @param {number} withinMs
 * @param {number} withinPx
 */
function isNear(first, second, withinMs, withinPx) {
  if (first === null || second.timeStamp - first.timeStamp > withinMs) return false;
  const awayPx = Math.hypot(second.clientX - first.clientX, second.clientY - first.clientY);
  return awayPx <= withinPx;
}
