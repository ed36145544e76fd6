/** Poses of cameras: their axes, matrices and lens, the up direction of a rig, and the near plane of a view. */

import { cross, dot, length, subtract, times, unit } from "./vectors.js";

/** See codec/rig.py. */
const LEAST_TURN = 0.01;
const MOST_LEAN = Math.SQRT1_2;
/** Keeps the sum of the squares invertible where all right axes lie in one plane. */
const TINY = 1e-9;

/** @typedef {import("./vectors.js").Vector} Vector */

/**
 * A camera's position and axes in the world frame.
 * @typedef {object} Pose
 * @property {Vector} position metres
 * @property {Vector} right @property {Vector} down @property {Vector} forward
 */

/** @param {{ w2c: number[] }} camera @returns {Pose} */
export function poseOf({ w2c }) {
  const [right, down, forward] = [0, 4, 8].map((at) => w2c.slice(at, at + 3));
  const shift = [w2c[3], w2c[7], w2c[11]];
  const position = [0, 1, 2].map(
    (axis) => -(right[axis] * shift[0] + down[axis] * shift[1] + forward[axis] * shift[2]),
  );
  return { position, right, down, forward };
}

/** World to camera, (4, 4) row by row. @param {Pose} pose @returns {number[]} */
export function worldToCamera({ position, right, down, forward }) {
  const rows = [right, down, forward].map((axis) => [...axis, -dot(axis, position)]);
  return [...rows.flat(), 0, 0, 0, 1];
}

/**
 * The view of a camera in a picture of another size: the whole view still shows, and if the shapes of
 * the pictures differ, two sides show more.
 * @param {import("../format/manifest.js").Camera} camera @param {number} widthPx @param {number} heightPx
 * @returns {import("../format/manifest.js").Camera}
 */
export function fitted(camera, widthPx, heightPx) {
  const scale = Math.min(widthPx / camera.widthPx, heightPx / camera.heightPx);
  return {
    ...camera,
    widthPx,
    heightPx,
    fxPx: camera.fxPx * scale,
    fyPx: camera.fyPx * scale,
    cxPx: widthPx / 2 + (camera.cxPx - camera.widthPx / 2) * scale,
    cyPx: heightPx / 2 + (camera.cyPx - camera.heightPx / 2) * scale,
  };
}

/**
 * The direction that is up for a rig: the one most square to all right axes, or where those say nothing
 * the mean of the tops of the pictures (codec/rig.py, rig_up).
 * @param {Pose[]} poses @returns {Vector}
 */
export function rigUp(poses) {
  const sum = (/** @type {(pose: Pose) => number} */ of) =>
    poses.reduce((total, pose) => total + of(pose), 0) / poses.length;
  const axes = [0, 1, 2];
  const tops = axes.map((axis) => sum(({ down }) => -down[axis]));
  const mean = unit(length(tops) > 1e-3 ? tops : times(poses[0].down, -1));
  const [a, b, c] = axes.map((i) =>
    axes.map((j) => sum(({ right }) => right[i] * right[j]) + (i === j ? TINY : 0)),
  );
  // The adjugate of a matrix is its inverse times a number: each round brings `up` nearer to the
  // direction of the smallest eigenvalue.
  const adjugate = [cross(b, c), cross(c, a), cross(a, b)];
  let up = mean;
  for (let round = 0; round < 40; round++) up = unit(axes.map((axis) => dot(adjugate[axis], up)));
  const least = dot(up, [dot(a, up), dot(b, up), dot(c, up)]);
  // The three eigenvalues have the sum 1: this is the product of the two larger ones.
  const turn = adjugate[0][0] + adjugate[1][1] + adjugate[2][2] - least * (1 - least);
  return turn < LEAST_TURN || dot(up, mean) < MOST_LEAN ? mean : up;
}

/**
 * A point in camera coordinates: right, down and forward, metres.
 * @param {number[]} w2c (4, 4) world to camera @param {Vector} point @returns {Vector}
 */
export function inCamera(w2c, point) {
  return [0, 4, 8].map((at) => dot(w2c.slice(at, at + 3), point) + w2c[at + 3]);
}

/**
 * Nearest depth drawn in a view, metres (FORMAT.md, section 4).
 * @param {Pick<import("../format/manifest.js").Manifest, "nearM" | "cameraNearM" | "cameras">} manifest
 * @param {{ w2c: number[] }} view
 */
export function nearOf({ nearM, cameraNearM, cameras }, view) {
  if (!cameraNearM.length) return nearM;
  const { position } = poseOf(view);
  const awayM = cameras.map((camera) => length(subtract(poseOf(camera).position, position)));
  const leastM = Math.min(...awayM);
  const ownM = cameraNearM[awayM.indexOf(leastM)];
  return ownM < nearM ? Math.min(ownM + leastM, nearM) : Math.max(ownM - leastM, nearM);
}
