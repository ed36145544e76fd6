/** Cameras for the two eyes of a viewer. */

import { poseOf, worldToCamera } from "../view/pose.js";
import { add, cross, dot, length, subtract, times, unit } from "../view/vectors.js";

/** @typedef {import("../format/manifest.js").Camera} Camera */
/** @typedef {import("../view/pose.js").Pose} Pose */

/** Typical distance between the pupils of adults. */
const EYE_DISTANCE_M = 0.063;
/** Side by side, the minimum distance from the eyes to the plane of the screen. */
const LEAST_FOCUS_M = 0.5;

/**
 * The view of one eye, and its part of the screen.
 * @typedef {object} EyeView
 * @property {Camera} camera its picture has the size of the part
 * @property {{ xPx: number, yPx: number }} corner lower left of the part
 */

/**
 * The cameras and the target of one picture.
 * @typedef {object} Viewpoint
 * @property {number[]} w2c (4, 4) world to camera: the depths that order the Gaussians for all eyes
 * @property {EyeView[]} views
 * @property {WebGLFramebuffer | null} framebuffer null: the canvas
 */

/**
 * The left eye on the left half of the canvas, the right one on the right.
 *
 * The eyes look in the same direction from both sides of `camera`. So a Gaussian has the same depth for
 * them and for `camera`, and one order is exact for all three. Their pictures are shifted so that a point
 * at the distance `focusM` shows at the same place in both, and appears in the plane of the screen.
 * @param {Camera} camera between the eyes, as large as one half @param {number} eyeDistanceM
 * @param {number} focusM @returns {Viewpoint}
 */
export function sideBySide(camera, eyeDistanceM, focusM) {
  const pose = poseOf(camera);
  const views = [-0.5, 0.5].map((side, index) => {
    const asideM = side * eyeDistanceM;
    const position = add(pose.position, times(pose.right, asideM));
    const eye = {
      ...camera,
      cxPx: camera.cxPx + (camera.fxPx * asideM) / focusM,
      w2c: worldToCamera({ ...pose, position }),
    };
    return { camera: eye, corner: { xPx: index * camera.widthPx, yPx: 0 } };
  });
  return { w2c: camera.w2c, views, framebuffer: null };
}

/**
 * Both eyes of an adult at the place of `camera`, for whom `centre` is in the plane of the screen.
 * @param {Camera} camera as large as one half of the canvas
 * @param {import("../view/vectors.js").Vector} centre @returns {Viewpoint}
 */
export function eyesAt(camera, centre) {
  const focusM = length(subtract(centre, poseOf(camera).position));
  return sideBySide(camera, EYE_DISTANCE_M, Math.max(focusM, LEAST_FOCUS_M));
}

/**
 * The mean pose of some eyes. If they look in the same direction, as in most headsets, the depths of a
 * Gaussian for the eyes differ only by a constant.
 * @param {Pose[]} poses @returns {Pose}
 */
export function middleOf(poses) {
  const sum = (/** @type {"position" | "right" | "forward"} */ of) =>
    poses.map((pose) => pose[of]).reduce(add);
  const forward = unit(sum("forward"));
  const aside = sum("right");
  const right = unit(subtract(aside, times(forward, dot(aside, forward))));
  const position = times(sum("position"), 1 / poses.length);
  return { position, right, down: cross(forward, right), forward };
}
