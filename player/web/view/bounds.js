/**
 * The bounds of the poses from which a camera still sees what the rig has filmed. Outside there is fog.
 *
 * The bounds are derived from the manifest only: from the hull of the rig's cameras and the region that they
 * look at. All cameras of the rig lie within the bounds.
 */

import { sceneCentre } from "./orbit.js";
import { poseOf, rigUp } from "./pose.js";
import { add, cross, dot, length, subtract, times } from "./vectors.js";

/** @typedef {import("./vectors.js").Vector} Vector */
/** @typedef {import("./pose.js").Pose} Pose */

const RAD_PER_DEG = Math.PI / 180;
/** A pose may look this much farther up and down than the rig's cameras do. */
const MORE_UP_RAD = 20 * RAD_PER_DEG;
const MORE_DOWN_RAD = 40 * RAD_PER_DEG;
/** Limit of the pitch, close to where the view would turn over; only a camera of the rig may be steeper. */
const STEEPEST_RAD = 80 * RAD_PER_DEG;
/** In a rig that films from one side, a pose may turn this much farther aside than its cameras. */
const MORE_ASIDE_RAD = 40 * RAD_PER_DEG;
/** A rig is one-sided if the directions of neighbouring cameras have a gap of at least this size. */
const OPEN_GAP_RAD = 170 * RAD_PER_DEG;
/** Maximum distance to the centre, as a multiple of the farthest camera's distance. */
const FARTHEST_SHARE = 1.5;
/** The same if most cameras stand in what was filmed: behind the walls of a room there is fog. */
const FARTHEST_INSIDE_SHARE = 1.1;
/** If the vertical part of a camera's right axis exceeds this, the camera lies on its side. */
const LIES = Math.SQRT1_2;
/** Limit of the looked-at point's height above or below the centre, as a share of the typical distance. */
const HIGH_SHARE = 1 / 3;
/** Minimum distance to the centre, as a share of the median camera's distance. */
const NEAREST_SHARE = 0.1;

/**
 * @typedef {object} Bounds
 * @property {Vector} centre of the scene, metres
 * @property {Vector} up unit
 * @property {Vector} north unit, level: the heading 0
 * @property {number} scaleM typical distance of a camera to the centre
 * @property {[number, number]} distanceM to the point that the camera turns around
 * @property {[number, number]} pitchRad down is positive
 * @property {{ middleRad: number, halfRad: number } | null} heading null: all around
 * @property {number} focusM maximum distance of the point that the camera looks at from the centre
 * @property {[number, number]} focusHeightM of that point above the centre
 * @property {[number, number]} heightM of a flying camera above the centre
 */

/** @param {import("./orbit.js").OrbitScene} scene @returns {Bounds} */
export function boundsOf({ cameras, bounds, defaultCamera }) {
  const poses = cameras.map(poseOf);
  const centre = sceneCentre(poses, bounds);
  const up = rigUp(poses);
  const north = levelOf(poseOf(defaultCamera), up);
  const distances = poses
    .map(({ position }) => length(subtract(position, centre)))
    .sort((a, b) => a - b);
  const halfDiagonalM = length(subtract(bounds[1], bounds[0])) / 2;
  const isInside = (/** @type {Pose} */ { position }) =>
    position.every((x, axis) => bounds[0][axis] <= x && x <= bounds[1][axis]);
  const areInside = 2 * poses.filter(isInside).length > poses.length;
  const medianM = distances[distances.length >> 1];
  const scaleM = medianM > 1e-3 * halfDiagonalM ? medianM : halfDiagonalM || 1;
  /** @type {[number, number]} */
  const distanceM = [
    Math.min(NEAREST_SHARE * scaleM, distances[0]),
    (areInside ? FARTHEST_INSIDE_SHARE : FARTHEST_SHARE) * Math.max(scaleM, ...distances),
  ];
  const pitches = poses.map((pose) => pitchOf(pose, up));
  // The single camera of an imported model gives no information about the model's other sides.
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
 * The amount by which a pose exceeds the bounds, for each of the motions that can bring it back.
 * @typedef {object} Excess
 * @property {number} logDistance @property {number} pitchRad @property {number} headingRad
 * @property {Vector} offM metres, world
 */

/**
 * @param {Bounds} bounds @param {Pose} pose
 * @param {number | null} distanceM to the point that the camera turns around; null if the camera flies
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
 * Downward pitch of a pose; it continues beyond a right angle when the pose goes over the scene's top.
 * @param {Pose} pose @param {Vector} up
 */
function pitchOf({ forward, down }, up) {
  return Math.atan2(-dot(forward, up), -dot(down, up));
}

/**
 * Heading of a pose, seen from above, counted to the left.
 * @param {Pose} pose @param {Vector} up @param {Vector} north
 */
function headingOf(pose, up, north) {
  const level = levelOf(pose, up);
  return Math.atan2(dot(cross(north, level), up), dot(north, level));
}

/**
 * The horizontal direction in which `pose` faces, defined even if it looks straight up or down.
 * @param {Pose} pose @param {Vector} up @returns {Vector} unit
 */
function levelOf({ right, forward }, up) {
  const lies = Math.abs(dot(right, up)) > LIES;
  const ahead = lies ? subtract(forward, times(up, dot(forward, up))) : cross(up, right);
  const size = length(ahead);
  if (size > 1e-6) return times(ahead, 1 / size);
  // The camera lies on its side and looks straight up or down. Any horizontal direction will do.
  const axis = Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
  const level = cross(up, axis);
  return times(level, 1 / length(level));
}

/** The point that a camera looks at, relative to the centre. @param {Pose} pose @param {Vector} centre */
function lookedAt({ position, forward }, centre) {
  const away = subtract(position, centre);
  return add(away, times(forward, length(away)));
}

/**
 * The arc of headings of a one-sided rig's cameras, with a margin; null if they look in all directions.
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
