/**
 * Where a camera still sees what the rig has filmed. Outside of it there is fog.
 *
 * The bounds are derived from the manifest alone: from the hull of the rig's cameras and the region that
 * they look at. All cameras of the rig lie within them.
 */

import { meanUp, poseOf } from "./pose.js";
import { sceneCentre } from "./scenecentre.js";
import { add, cross, dot, length, subtract, times } from "./vectors.js";

/** @typedef {import("./vectors.js").Vector} Vector */
/** @typedef {import("./pose.js").Pose} Pose */

const RAD_PER_DEG = Math.PI / 180;
/** A pose may look this much farther up and down than the rig's cameras do. */
const MORE_UP_RAD = 20 * RAD_PER_DEG;
const MORE_DOWN_RAD = 40 * RAD_PER_DEG;
/** Beyond it up and down change places; only a camera of the rig may look steeper. */
const STEEPEST_RAD = 80 * RAD_PER_DEG;
/** A pose may turn this much farther aside than the cameras of a rig that films from one side. */
const MORE_ASIDE_RAD = 40 * RAD_PER_DEG;
/** A gap between the directions of neighbouring cameras that makes a rig one-sided. */
const OPEN_GAP_RAD = 170 * RAD_PER_DEG;
/** Farthest from the centre, as a share of the farthest camera's distance. */
const FARTHEST_SHARE = 1.5;
/** A camera whose right axis points up this far was turned on its side. */
const LIES = Math.SQRT1_2;
/** The point that a camera looks at may lie this much higher or lower than the centre, in typical distances. */
const HIGH_SHARE = 1 / 3;
/** Nearest to the centre, as a share of the median camera's distance. */
const NEAREST_SHARE = 0.1;

/**
 * @typedef {object} Bounds
 * @property {Vector} centre of the scene, metres
 * @property {Vector} up unit
 * @property {Vector} north unit, level: the heading 0
 * @property {number} scaleM typical distance of a camera to the centre
 * @property {[number, number]} distanceM to what the camera turns around
 * @property {[number, number]} pitchRad down is positive
 * @property {{ middleRad: number, halfRad: number } | null} heading null: all around
 * @property {number} focusM farthest that the point the camera looks at may lie from the centre
 * @property {[number, number]} focusHeightM of that point above the centre
 * @property {[number, number]} heightM of a flying camera above the centre
 */

/**
 * @param {import("./orbit.js").OrbitScene} scene
 * @returns {Bounds}
 */
export function boundsOf({ cameras, bounds, defaultCamera }) {
  const poses = cameras.map(poseOf);
  const centre = sceneCentre(poses, bounds);
  const up = meanUp(poses);
  const north = levelOf(poseOf(defaultCamera), up);
  const distances = poses
    .map(({ position }) => length(subtract(position, centre)))
    .sort((a, b) => a - b);
  const halfDiagonalM = length(subtract(bounds[1], bounds[0])) / 2;
  const medianM = distances[distances.length >> 1];
  const scaleM = medianM > 1e-3 * halfDiagonalM ? medianM : halfDiagonalM || 1;
  /** @type {[number, number]} */
  const distanceM = [
    Math.min(NEAREST_SHARE * scaleM, distances[0]),
    FARTHEST_SHARE * Math.max(scaleM, ...distances),
  ];
  const pitches = poses.map((pose) => pitchOf(pose, up));
  // The camera of an imported model says nothing about the other sides of the model.
  const isAlone = poses.length === 1;
  const steepest = [-STEEPEST_RAD, STEEPEST_RAD];
  const margins = isAlone ? steepest : [-MORE_UP_RAD, MORE_DOWN_RAD];
  /** @type {[number, number]} */
  const pitchRad = [
    Math.min(...pitches, Math.max(Math.min(...pitches) + margins[0], steepest[0])),
    Math.max(...pitches, Math.min(Math.max(...pitches) + margins[1], steepest[1])),
  ];
  const looked = poses.map((pose) => times(lookedAt(pose, centre), FARTHEST_SHARE));
  const lookedHeights = looked.map((point) => dot(point, up));
  const regionM = Math.min(Math.max(halfDiagonalM, scaleM / 2), scaleM);
  const heights = poses.map(({ position }) => dot(subtract(position, centre), up));
  return {
    centre,
    up,
    north,
    scaleM,
    distanceM,
    pitchRad,
    heading: isAlone ? null : headingArc(poses.map((pose) => headingOf(pose, up, north))),
    focusM: Math.max(regionM, ...looked.map(length)),
    focusHeightM: [
      Math.min(-HIGH_SHARE * scaleM, ...lookedHeights),
      Math.max(HIGH_SHARE * scaleM, ...lookedHeights),
    ],
    heightM: [
      Math.min(...heights, distanceM[1] * Math.sin(pitchRad[0])),
      Math.max(...heights, distanceM[1] * Math.sin(pitchRad[1])),
    ],
  };
}

/**
 * By how much a pose is out of the bounds, in each of the ways in which it can be brought back.
 * @typedef {object} Excess
 * @property {number} logDistance
 * @property {number} pitchRad
 * @property {number} headingRad
 * @property {Vector} offM metres, world
 */

/**
 * @param {Bounds} bounds
 * @param {Pose} pose
 * @param {number | null} distanceM to what the camera turns around; null: it flies
 * @returns {Excess} all 0 within the bounds
 */
export function excessOf(bounds, pose, distanceM) {
  const { centre, up } = bounds;
  const isFlying = distanceM === null;
  const away = subtract(pose.position, centre);
  const [off, mostM, heightM] = isFlying
    ? [away, bounds.distanceM[1], bounds.heightM]
    : [add(away, times(pose.forward, distanceM)), bounds.focusM, bounds.focusHeightM];
  const offM = length(off);
  const inside = times(off, offM > mostM ? mostM / offM : 1);
  const level = subtract(inside, times(up, outside(dot(inside, up), ...heightM)));
  return {
    logDistance: isFlying || distanceM <= 0 ? 0 : logOutside(distanceM, bounds.distanceM),
    pitchRad: isFlying
      ? outside(pitchOf(pose, up), -STEEPEST_RAD, STEEPEST_RAD)
      : outside(pitchOf(pose, up), ...bounds.pitchRad),
    headingRad: isFlying ? 0 : headingExcess(bounds, pose),
    offM: subtract(off, level),
  };
}

/** @param {number} x @param {number} lower @param {number} upper */
function outside(x, lower, upper) {
  return x - Math.min(Math.max(x, lower), upper);
}

/** @param {number} distanceM @param {[number, number]} range */
function logOutside(distanceM, [leastM, mostM]) {
  if (distanceM < leastM) return Math.log(distanceM / leastM);
  return distanceM > mostM ? Math.log(distanceM / mostM) : 0;
}

/** @param {Bounds} bounds @param {Pose} pose */
function headingExcess({ up, north, heading }, pose) {
  if (heading === null) return 0;
  const asideRad = wrapped(headingOf(pose, up, north) - heading.middleRad);
  return outside(asideRad, -heading.halfRad, heading.halfRad);
}

/**
 * How far a pose looks down; over the top of the scene it goes on beyond a right angle.
 * @param {Pose} pose
 * @param {Vector} up
 */
function pitchOf({ forward, down }, up) {
  return Math.atan2(-dot(forward, up), -dot(down, up));
}

/**
 * Where a pose looks, seen from above, counted to the left.
 * @param {Pose} pose
 * @param {Vector} up
 * @param {Vector} north
 */
function headingOf(pose, up, north) {
  const level = levelOf(pose, up);
  return Math.atan2(dot(cross(north, level), up), dot(north, level));
}

/**
 * The level direction of someone who faces as `pose` does, also straight up or down.
 * @param {Pose} pose
 * @param {Vector} up
 * @returns {Vector} unit
 */
function levelOf({ right, forward }, up) {
  const lies = Math.abs(dot(right, up)) > LIES;
  const ahead = lies ? subtract(forward, times(up, dot(forward, up))) : cross(up, right);
  const size = length(ahead);
  if (size > 1e-6) return times(ahead, 1 / size);
  // It lies on its side and looks straight down. Any level direction will do.
  const axis = Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
  const level = cross(up, axis);
  return times(level, 1 / length(level));
}

/**
 * The point that a camera looks at, from the centre.
 * @param {Pose} pose
 * @param {Vector} centre
 */
function lookedAt({ position, forward }, centre) {
  const away = subtract(position, centre);
  return add(away, times(forward, length(away)));
}

/**
 * The arc in which the cameras of a one-sided rig look, with a margin; null if they look all around.
 * @param {number[]} headings radians
 */
function headingArc(headings) {
  const sorted = [...headings].sort((a, b) => a - b);
  const gaps = sorted.map((heading, i) => {
    const next = i + 1 < sorted.length ? sorted[i + 1] : sorted[0] + 2 * Math.PI;
    return next - heading;
  });
  const widest = Math.max(...gaps);
  if (widest < OPEN_GAP_RAD) return null;
  const first = sorted[(gaps.indexOf(widest) + 1) % sorted.length];
  const arcRad = 2 * Math.PI - widest;
  return { middleRad: first + arcRad / 2, halfRad: arcRad / 2 + MORE_ASIDE_RAD };
}

/** An angle within -pi and pi. @param {number} angleRad */
function wrapped(angleRad) {
  return Math.atan2(Math.sin(angleRad), Math.cos(angleRad));
}
