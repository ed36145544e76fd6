/** The first view, which turns around a point: the middle of the scene, the lens for a picture's shape, and drags. */

import { fitted, inCamera, poseOf, rigUp, worldToCamera } from "./pose.js";
import {
  add,
  axesOf,
  dot,
  length,
  normalised,
  quaternionOf,
  subtract,
  times,
  turned,
} from "./vectors.js";

/** @typedef {import("./vectors.js").Vector} Vector */

/**
 * The point that a rig's cameras look at: the one with the least squared distance to their axes. The
 * middle of the bounds if the axes are almost parallel, or if that point is out of bounds or behind a camera.
 * @param {import("./pose.js").Pose[]} poses @param {number[][]} bounds @returns {Vector}
 */
export function sceneCentre(poses, bounds) {
  const middle = times(add(bounds[0], bounds[1]), 0.5);
  const point = closestPoint(poses);
  const isInside = point?.every((x, axis) => bounds[0][axis] <= x && x <= bounds[1][axis]);
  return point && isInside ? point : middle;
}

/** @param {import("./pose.js").Pose[]} poses @returns {Vector | null} */
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

/** @typedef {import("../format/manifest.js").Camera} Camera */

/**
 * A narrow picture is at most this many times as high as the camera's view. The parts above and below
 * the view were seen by hardly any camera.
 */
const MOST_HEIGHTS = 4 / 3;
/** Share of the extra height above the view: cameras see more floor than ceiling, and controls lie below. */
const SHARE_ABOVE = 1 / 4;

/**
 * The lens that shows a camera's view in a picture of another size.
 *
 * A picture narrower than the camera's shows a part of the view, centred on `focus` as far as the view allows. Its
 * scale is the geometric mean of showing the whole view and filling the picture with the view, but the picture is at
 * most MOST_HEIGHTS times as high as the view. A wider picture shows the whole view, and more on both sides.
 * @param {Camera} camera @param {import("./vectors.js").Vector} focus metres @param {number} widthPx
 * @param {number} heightPx @returns {Camera} with the pose of `camera`
 */
function framed(camera, focus, widthPx, heightPx) {
  const whole = fitted(camera, widthPx, heightPx);
  const [least, most] = [widthPx / camera.widthPx, heightPx / camera.heightPx];
  if (least >= most) return whole;
  const scale = Math.max(Math.sqrt(least * most), most / MOST_HEIGHTS);
  const middlePx = shareAt(camera, focus) * camera.widthPx;
  const spareWidthPx = camera.widthPx * scale - widthPx;
  const leftPx = Math.min(Math.max(middlePx * scale - widthPx / 2, 0), spareWidthPx);
  return {
    ...whole,
    fxPx: camera.fxPx * scale,
    fyPx: camera.fyPx * scale,
    cxPx: camera.cxPx * scale - leftPx,
    cyPx: camera.cyPx * scale + SHARE_ABOVE * (heightPx - camera.heightPx * scale),
  };
}

/**
 * Where a point is in a camera's picture, from 0 at its left edge to 1 at its right; the middle if it is behind
 * the camera.
 * @param {Camera} camera @param {import("./vectors.js").Vector} point metres
 */
export function shareAt(camera, point) {
  const [x, , z] = inCamera(camera.w2c, point);
  return z > 0 ? ((camera.fxPx * x) / z + camera.cxPx) / camera.widthPx : 1 / 2;
}

/**
 * The part of a manifest that an orbit uses.
 * @typedef {object} OrbitScene
 * @property {import("../format/manifest.js").Camera[]} cameras
 * @property {import("../format/manifest.js").Camera} defaultCamera
 * @property {number[][]} bounds lower and upper corner, metres
 * @property {number[] | null} [focus] metres
 */

const LEAST_ZOOM = 0.02;
const MOST_ZOOM = 50;
/** Links may come from anywhere; larger numbers would leave floats no digits for the scene. */
const MOST_IN_TEXT = 1e6;

/**
 * The camera as turned, moved and zoomed around `centre`, starting from the pose `base`. At first both
 * are those of the stream; a flight changes them. This class knows nothing about time or about the
 * bounds of a scene; see cameramotion.js.
 */
export class Orbit {
  turnRad = 0;
  tiltRad = 0;
  /** Distance to the centre as a share of the base's. */
  zoom = 1;
  /** Right and down, in units of the distance to the centre. */
  pan = [0, 0];

  /** @param {OrbitScene} scene */
  constructor({ cameras, bounds, defaultCamera, focus }) {
    const poses = cameras.map(poseOf);
    /** The pose and centre that a reset returns to. */
    this.home = { pose: poseOf(defaultCamera), centre: sceneCentre(poses, bounds) };
    this.base = this.home.pose;
    /** @type {Vector} */ this.centre = this.home.centre;
    /** @type {Vector} */ this.up = rigUp(poses);
    /** The point that a picture too narrow for the whole view shows. @type {number[]} */
    this.focus = focus ?? this.home.centre;
  }

  reset() {
    this.rebase(this.home.pose, this.home.centre);
  }

  /**
   * Puts the camera at `pose`; from then on it turns around `centre`.
   * @param {import("./pose.js").Pose} pose @param {Vector} centre
   */
  rebase(pose, centre) {
    this.base = pose;
    this.centre = centre;
    this.turnRad = 0;
    this.tiltRad = 0;
    this.zoom = 1;
    this.pan = [0, 0];
  }

  /** @param {number} leftRad @param {number} upRad */
  turn(leftRad, upRad) {
    this.turnRad += leftRad;
    this.tiltRad = Math.min(Math.max(this.tiltRad + upRad, -Math.PI / 2), Math.PI / 2);
  }

  /** Multiplies the distance to the centre by `factor`. @param {number} factor */
  scale(factor) {
    this.zoom = Math.min(Math.max(this.zoom * factor, LEAST_ZOOM), MOST_ZOOM);
  }

  /** @returns {import("./pose.js").Pose} */
  get pose() {
    const { centre, zoom } = this;
    let pose = carried(this.base, centre, this.up, this.turnRad);
    pose = carried(pose, centre, pose.right, this.tiltRad);
    const away = times(subtract(pose.position, centre), zoom);
    const aside = add(times(pose.right, this.pan[0]), times(pose.down, this.pan[1]));
    const position = subtract(add(centre, away), times(aside, length(away)));
    return { ...pose, position };
  }

  /**
   * The camera for a picture of the given size, with the lens of `start`.
   * @param {import("../format/manifest.js").Camera} start @param {number} widthPx @param {number} heightPx
   */
  camera(start, widthPx, heightPx) {
    const lens = framed(start, this.focus, widthPx, heightPx);
    return { ...lens, w2c: worldToCamera(this.pose) };
  }

  /**
   * The view as a short text, for links: turn, tilt, zoom, pan to the right and down. After a flight it
   * is the pose itself: position, quaternion, centre.
   */
  get text() {
    const { base, centre, home } = this;
    let numbers = [this.turnRad, this.tiltRad, this.zoom, ...this.pan];
    if (base !== home.pose || centre !== home.centre) {
      const { pose } = this;
      numbers = [...pose.position, ...quaternionOf(pose), ...centre];
    }
    return numbers.map((x) => Number(x.toFixed(4))).join(",");
  }

  /** Restores a view from its text; invalid text changes nothing. @param {string} text */
  set text(text) {
    const numbers = text.split(",").map(Number);
    if (!numbers.every((x) => Math.abs(x) <= MOST_IN_TEXT)) return;
    if (numbers.length === 5) {
      const [turnRad, tiltRad, zoom, right, down] = numbers;
      this.reset();
      this.turn(turnRad % (2 * Math.PI), tiltRad);
      this.scale(zoom);
      this.pan = [right, down];
    } else if (numbers.length === 10 && Math.hypot(...numbers.slice(3, 7)) > 0.5) {
      const axes = axesOf(normalised(numbers.slice(3, 7)));
      this.rebase({ position: numbers.slice(0, 3), ...axes }, numbers.slice(7));
    }
  }
}

/**
 * A pose rotated about an axis through `centre`.
 * @param {import("./pose.js").Pose} pose @param {Vector} centre @param {Vector} axis unit
 * @param {number} angleRad @returns {import("./pose.js").Pose}
 */
function carried(pose, centre, axis, angleRad) {
  const turn = (/** @type {Vector} */ a) => turned(a, axis, angleRad);
  return {
    position: add(centre, turn(subtract(pose.position, centre))),
    right: turn(pose.right),
    down: turn(pose.down),
    forward: turn(pose.forward),
  };
}
