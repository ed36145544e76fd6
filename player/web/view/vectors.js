/** Vectors of three numbers, and rotations between poses. */

/** @typedef {number[]} Vector three numbers */

/** @param {Vector} a @param {Vector} b */
export function add(a, b) {
  return [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
}

/** @param {Vector} a @param {Vector} b */
export function subtract(a, b) {
  return [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
}

/** @param {Vector} a @param {number} factor */
export function times(a, factor) {
  return [a[0] * factor, a[1] * factor, a[2] * factor];
}

/** @param {Vector} a @param {Vector} b */
export function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/** @param {Vector} a @param {Vector} b */
export function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/** @param {Vector} a */
export function length(a) {
  return Math.hypot(a[0], a[1], a[2]);
}

/** @param {Vector} a */
export function unit(a) {
  return times(a, 1 / length(a));
}

/** `a` turned about a unit vector. @param {Vector} a @param {Vector} axis @param {number} angleRad */
export function turned(a, axis, angleRad) {
  const sine = Math.sin(angleRad);
  const cosine = Math.cos(angleRad);
  const along = times(axis, dot(axis, a) * (1 - cosine));
  return add(add(times(a, cosine), times(cross(axis, a), sine)), along);
}

/** @typedef {import("./pose.js").Pose} Pose */

/**
 * The rotation from the world's axes to those of a pose.
 * @param {Pose} pose @returns {number[]} unit quaternion, w x y z
 */
export function quaternionOf({ right, down, forward }) {
  const [a, b, c] = [right, down, forward];
  const sums = [
    1 + a[0] + b[1] + c[2],
    1 + a[0] - b[1] - c[2],
    1 - a[0] + b[1] - c[2],
    1 - a[0] - b[1] + c[2],
  ];
  // The largest component is at least 0.5, so the others are not divided by a small number.
  const largest = sums.indexOf(Math.max(...sums));
  const s = sums[largest];
  const [x, y, z] = [b[2] - c[1], c[0] - a[2], a[1] - b[0]];
  const [xy, xz, yz] = [a[1] + b[0], a[2] + c[0], b[2] + c[1]];
  const rows = [
    [s, x, y, z],
    [x, s, xy, xz],
    [y, xy, s, yz],
    [z, xz, yz, s],
  ];
  return normalised(rows[largest]);
}

/**
 * The axes of a pose, from its `quaternionOf`.
 * @param {number[]} quaternion unit, w x y z @returns {{ right: Vector, down: Vector, forward: Vector }}
 */
export function axesOf([w, x, y, z]) {
  const right = unit([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]);
  const rough = [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)];
  const forward = unit(cross(right, rough));
  return { right, down: cross(forward, right), forward };
}

/** @param {number[]} quaternion */
export function normalised(quaternion) {
  const size = Math.hypot(...quaternion);
  return quaternion.map((q) => q / size);
}
