import { fitted, meanUp, poseOf, worldToCamera } from "./pose.js";
import { add, dot, length, subtract, times, turned } from "./vectors.js";

/** @typedef {import("./vectors.js").Vector} Vector */

const TURN_RAD_PER_PX = 0.005;
/** Distance to the scene's centre after one step of the wheel, as a share of that before. */
const ZOOM_PER_STEP = 0.9;
const LEAST_ZOOM = 0.02;
const MOST_ZOOM = 50;

/**
 * Where the cameras of a rig look: the point with the least squared distance to their axes, or the
 * middle of the bounds where they look the same way.
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
  // The axes are as good as parallel.
  if (!(det > 1e-3)) return null;
  const point = [0, 1, 2].map(
    (i) => [0, 1, 2].reduce((sum, j) => sum + ((i + j) % 2 ? -1 : 1) * minor(j, i) * b[j], 0) / det,
  );
  const isSeen = poses.every(
    ({ position, forward }) => dot(subtract(point, position), forward) > 0,
  );
  return isSeen ? point : null;
}

/** Where a person has turned, moved and zoomed the camera. */
export class Orbit {
  turnRad = 0;
  tiltRad = 0;
  /** Distance to the centre as a share of the start's. */
  zoom = 1;
  /** To the right and down, in distances to the centre per focal length. */
  pan = [0, 0];

  /** @param {{ cameras: import("../format/camera.js").Camera[], bounds: number[][] }} scene */
  constructor({ cameras, bounds }) {
    const poses = cameras.map(poseOf);
    this.centre = sceneCentre(poses, bounds);
    this.up = meanUp(poses);
  }

  reset() {
    this.turnRad = 0;
    this.tiltRad = 0;
    this.zoom = 1;
    this.pan = [0, 0];
  }

  /**
   * The near side of the scene follows the pointer.
   * @param {number} rightPx
   * @param {number} downPx
   */
  dragTurn(rightPx, downPx) {
    this.turnRad -= rightPx * TURN_RAD_PER_PX;
    const tiltRad = this.tiltRad - downPx * TURN_RAD_PER_PX;
    this.tiltRad = Math.min(Math.max(tiltRad, -Math.PI / 2), Math.PI / 2);
  }

  /**
   * @param {number} rightPx
   * @param {number} downPx
   * @param {number} focalPx
   */
  dragPan(rightPx, downPx, focalPx) {
    this.pan = [this.pan[0] + rightPx / focalPx, this.pan[1] + downPx / focalPx];
  }

  /** Nearer by so many steps of a wheel. @param {number} steps */
  approach(steps) {
    this.scale(ZOOM_PER_STEP ** steps);
  }

  /** Makes the distance to the centre `factor` times what it was. @param {number} factor */
  scale(factor) {
    this.zoom = Math.min(Math.max(this.zoom * factor, LEAST_ZOOM), MOST_ZOOM);
  }

  /**
   * `start` as the person wants it, in a picture of another size.
   * @param {import("../format/camera.js").Camera} start
   * @param {number} widthPx
   * @param {number} heightPx
   */
  camera(start, widthPx, heightPx) {
    let pose = carried(poseOf(start), this.centre, this.up, this.turnRad);
    pose = carried(pose, this.centre, pose.right, this.tiltRad);
    const away = times(subtract(pose.position, this.centre), this.zoom);
    const aside = add(times(pose.right, this.pan[0]), times(pose.down, this.pan[1]));
    const position = subtract(add(this.centre, away), times(aside, length(away)));
    const w2c = worldToCamera({ ...pose, position });
    return {
      ...closer(fitted(start, widthPx, heightPx), closeness(start, widthPx, heightPx)),
      w2c,
    };
  }

  /** All of it as a short text, for a link. */
  get text() {
    const numbers = [this.turnRad, this.tiltRad, this.zoom, ...this.pan];
    return numbers.map((x) => Number(x.toFixed(4))).join(",");
  }

  /** Takes what `text` gave; anything else changes nothing. @param {string} text */
  set text(text) {
    const numbers = text.split(",").map(Number);
    if (numbers.length !== 5 || !numbers.every(Number.isFinite)) return;
    const [turnRad, tiltRad, zoom, right, down] = numbers;
    this.turnRad = turnRad % (2 * Math.PI);
    this.tiltRad = Math.min(Math.max(tiltRad, -Math.PI / 2), Math.PI / 2);
    this.zoom = Math.min(Math.max(zoom, LEAST_ZOOM), MOST_ZOOM);
    this.pan = [right, down];
  }
}

/**
 * How much larger all is in an upright picture of a view that is not: halfway, as factors go, between
 * all of the view and a picture that it fills. Most of a phone would show what hardly a camera saw.
 * @param {{ widthPx: number, heightPx: number }} start
 * @param {number} widthPx
 * @param {number} heightPx
 */
export function closeness(start, widthPx, heightPx) {
  if (widthPx >= heightPx) return 1;
  return Math.sqrt(Math.max(1, (heightPx / start.heightPx) * (start.widthPx / widthPx)));
}

/**
 * @param {import("../format/camera.js").Camera} camera
 * @param {number} factor
 * @returns {import("../format/camera.js").Camera}
 */
function closer(camera, factor) {
  const { widthPx, heightPx, fxPx, fyPx, cxPx, cyPx } = camera;
  return {
    ...camera,
    fxPx: fxPx * factor,
    fyPx: fyPx * factor,
    cxPx: widthPx / 2 + (cxPx - widthPx / 2) * factor,
    cyPx: heightPx / 2 + (cyPx - heightPx / 2) * factor,
  };
}

/**
 * A pose carried around a line through `centre`.
 * @param {import("./pose.js").Pose} pose
 * @param {Vector} centre
 * @param {Vector} axis unit
 * @param {number} angleRad
 * @returns {import("./pose.js").Pose}
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
