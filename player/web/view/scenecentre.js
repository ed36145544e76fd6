import { add, dot, subtract, times } from "./vectors.js";

/** @typedef {import("./vectors.js").Vector} Vector */

/**
 * The point that a rig's cameras look at: the one with the least squared distance to their axes. The
 * middle of the bounds if the axes are almost parallel, or if that point is out of bounds or behind a camera.
 * @param {import("./pose.js").Pose[]} poses
 * @param {number[][]} bounds
 * @returns {Vector}
 */
export function sceneCentre(poses, bounds) {
  const middle = times(add(bounds[0], bounds[1]), 0.5);
  const point = closestPoint(poses);
  const isInside = point?.every((x, axis) => bounds[0][axis] <= x && x <= bounds[1][axis]);
  return point && isInside ? point : middle;
}

/**
 * @param {import("./pose.js").Pose[]} poses
 * @returns {Vector | null}
 */
function closestPoint(poses) {
  // The sum over all axes of (I - d d^T) (x - p) is 0.
  const a = [0, 0, 0, 0, 0, 0, 0, 0, 0];
  const b = [0, 0, 0];
  for (const { position, forward: d } of poses) {
    for (let i = 0; i < 3; i++) {
      for (let j = 0; j < 3; j++) {
        const entry = (i === j ? 1 : 0) - d[i] * d[j];
        a[3 * i + j] += entry / poses.length;
        b[i] += (entry * position[j]) / poses.length;
      }
    }
  }
  const minor = (/** @type {number} */ i, /** @type {number} */ j) => {
    const [r, s] = [0, 1, 2].filter((row) => row !== i);
    const [c, e] = [0, 1, 2].filter((column) => column !== j);
    return a[3 * r + c] * a[3 * s + e] - a[3 * r + e] * a[3 * s + c];
  };
  const det = a[0] * minor(0, 0) - a[1] * minor(0, 1) + a[2] * minor(0, 2);
  // The axes are almost parallel.
  if (!(det > 1e-3)) return null;
  const point = [0, 1, 2].map(
    (i) => [0, 1, 2].reduce((sum, j) => sum + ((i + j) % 2 ? -1 : 1) * minor(j, i) * b[j], 0) / det,
  );
  const isSeen = poses.every(
    ({ position, forward }) => dot(subtract(point, position), forward) > 0,
  );
  return isSeen ? point : null;
}
