/** Fits a camera's view into a picture of another shape. */

import { fitted, inCamera } from "./pose.js";

/** @typedef {import("../format/camera.js").Camera} Camera */

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
 * A picture narrower than the camera's shows a part of the view, centred on `focus` as far as the view
 * allows. Its scale is the geometric mean of showing the whole view and filling the picture with the
 * view, but the picture is at most MOST_HEIGHTS times as high as the view. A wider picture shows the
 * whole view, and more on both sides.
 * @param {Camera} camera
 * @param {import("./vectors.js").Vector} focus metres
 * @param {number} widthPx
 * @param {number} heightPx
 * @returns {Camera} with the pose of `camera`
 */
export function framed(camera, focus, widthPx, heightPx) {
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
 * @param {Camera} camera
 * @param {import("./vectors.js").Vector} point metres
 */
export function shareAt(camera, point) {
  const [x, , z] = inCamera(camera.w2c, point);
  return z > 0 ? ((camera.fxPx * x) / z + camera.cxPx) / camera.widthPx : 1 / 2;
}
