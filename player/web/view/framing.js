/** How a picture of another shape than a camera's shows the camera's view. */

import { fitted, inCamera } from "./pose.js";

/** @typedef {import("../format/camera.js").Camera} Camera */

/**
 * A narrow picture is at most this many times as high as the camera's view. Above and below it shows
 * what hardly a camera saw.
 */
const MOST_HEIGHTS = 4 / 3;
/** The part of that above: cameras see floors more often than ceilings, and controls lie below. */
const SHARE_ABOVE = 1 / 4;

/**
 * The lens with which a camera's view is shown in a picture of another size.
 *
 * A picture that is narrower than the camera's shows a part of the view, with `centre` in its middle as
 * far as the view goes. It is halfway, as factors go, between all of the view and a picture that the
 * view fills, but not much higher than the view. A wider picture shows all of the view, and more at both
 * sides.
 * @param {Camera} camera
 * @param {import("./vectors.js").Vector} centre of the scene, metres
 * @param {number} widthPx
 * @param {number} heightPx
 * @returns {Camera} with the pose of `camera`
 */
export function framed(camera, centre, widthPx, heightPx) {
  const whole = fitted(camera, widthPx, heightPx);
  const [least, most] = [widthPx / camera.widthPx, heightPx / camera.heightPx];
  if (least >= most) return whole;
  const scale = Math.max(Math.sqrt(least * most), most / MOST_HEIGHTS);
  const [x, , z] = inCamera(camera.w2c, centre);
  const middlePx = z > 0 ? (camera.fxPx * x) / z + camera.cxPx : camera.widthPx / 2;
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
