const TURN_RAD_PER_S = 0.25;
/** Where the rig's cameras limit the turn, the camera sways by so much to each side. */
const SWAY_RAD = 0.15;
/** Pictures may be far apart; a longer step would jump. */
const LONGEST_STEP_S = 0.1;

/**
 * Turns the camera around a model, slowly, as long as nobody has touched it: it shows that the picture is
 * not flat. Uses no clock.
 */
export class Turntable {
  #lastMs = NaN;
  #turnedS = 0;

  /** @param {import("./cameramotion.js").CameraMotion} motion */
  constructor(motion) {
    this.motion = motion;
  }

  /** Advances to a time. @param {number} nowMs */
  step(nowMs) {
    const stepS = Math.min(Math.max((nowMs - this.#lastMs) / 1000, 0), LONGEST_STEP_S);
    this.#lastMs = nowMs;
    if (!(stepS > 0)) return;
    const { motion } = this;
    const isFree = motion.bounds.heading === null;
    const before = this.#angleRad(isFree);
    this.#turnedS += stepS;
    motion.turn(this.#angleRad(isFree) - before, 0);
  }

  /** @param {boolean} isFree */
  #angleRad(isFree) {
    const angleRad = TURN_RAD_PER_S * this.#turnedS;
    return isFree ? angleRad : SWAY_RAD * Math.sin(angleRad / SWAY_RAD);
  }
}
