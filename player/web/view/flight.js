/** Motion that nobody steers: flights between poses, and the turntable. */

import { add, axesOf, length, normalised, quaternionOf, subtract, times } from "./vectors.js";

/** @typedef {import("./vectors.js").Vector} Vector */
/** @typedef {import("./pose.js").Pose} Pose */

/**
 * A camera's pose, and the point it turns around.
 * @typedef {object} Place
 * @property {Pose} pose
 * @property {Vector} centre metres
 */

export const FLIGHT_S = 0.8;

/** Share of the way after a share of the time; starts and ends at rest. @param {number} share 0 to 1 */
export function eased(share) {
  return share * share * share * (share * (6 * share - 15) + 10);
}

/**
 * The place at a share of the way between two places. The camera turns evenly around a centre that moves
 * in a straight line, and its distance to the centre changes geometrically.
 * @param {Place} from @param {Place} to @param {number} share 0 to 1 @returns {Place}
 */
export function between(from, to, share) {
  if (share <= 0) return from;
  if (share >= 1) return to;
  const axes = axesOf(slerp(quaternionOf(from.pose), quaternionOf(to.pose), share));
  const centre = mixed(from.centre, to.centre, share);
  const [start, end] = [from, to].map(seenOf);
  let seen = mixed(start, end, share);
  const [startM, endM, mixedM] = [start, end, seen].map(length);
  if (startM > 0 && endM > 0 && mixedM > 0.1 * Math.min(startM, endM))
    seen = times(seen, (startM * (endM / startM) ** share) / mixedM);
  const away = [axes.right, axes.down, axes.forward].map((axis, i) => times(axis, seen[i]));
  return { pose: { position: subtract(centre, away.reduce(add)), ...axes }, centre };
}

/** Quaternions with a larger cosine between them are interpolated linearly. */
const NEARLY_ONE = 0.9999;

/**
 * The rotation at a share of the way between two rotations, at constant speed along the shorter way.
 * @param {number[]} from unit quaternion @param {number[]} to unit quaternion @param {number} share 0 to 1
 * @returns {number[]}
 */
function slerp(from, to, share) {
  const along = from.reduce((sum, q, i) => sum + q * to[i], 0);
  const near = to.map((q) => (along < 0 ? -q : q));
  const cosine = Math.min(1, Math.abs(along));
  let [a, b] = [1 - share, share];
  if (cosine < NEARLY_ONE) {
    const angleRad = Math.acos(cosine);
    a = Math.sin(a * angleRad) / Math.sin(angleRad);
    b = Math.sin(b * angleRad) / Math.sin(angleRad);
  }
  return normalised(from.map((q, i) => a * q + b * near[i]));
}

/** The centre in camera coordinates: right, down and forward. @param {Place} place */
function seenOf({ pose, centre }) {
  const towards = subtract(centre, pose.position);
  return [pose.right, pose.down, pose.forward].map((axis) =>
    axis.reduce((sum, x, i) => sum + x * towards[i], 0),
  );
}

/** @param {Vector} a @param {Vector} b @param {number} share */
function mixed(a, b, share) {
  return add(times(a, 1 - share), times(b, share));
}

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
