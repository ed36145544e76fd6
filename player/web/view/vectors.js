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

/**
 * `a` turned about a unit vector.
 * @param {Vector} a
 * @param {Vector} axis
 * @param {number} angleRad
 */
export function turned(a, axis, angleRad) {
  const sine = Math.sin(angleRad);
  const cosine = Math.cos(angleRad);
  const along = times(axis, dot(axis, a) * (1 - cosine));
  return add(add(times(a, cosine), times(cross(axis, a), sine)), along);
}
