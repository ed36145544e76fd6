import { depthAt } from "../renderer/depthquery.js";
import { pointAt } from "../view/pose.js";

/** Places of the canvas, and what shows there. */

/**
 * The point of the scene at a place of the canvas; null where the picture is empty.
 * @param {import("./sceneview.js").SceneView} view
 * @param {number} xPx from the left, in CSS pixels
 * @param {number} yPx from the top
 */
export function scenePointAt({ camera, painter, size, isEmpty }, xPx, yPx) {
  if (camera === null || isEmpty) return null;
  const x = (xPx * size.pixelRatio) % camera.widthPx; // side by side there are two pictures
  const y = yPx * size.pixelRatio;
  const { renderer } = painter;
  const depthM = renderer && depthAt(renderer, camera, x, y);
  return depthM === null ? null : pointAt(camera, x, y, depthM);
}

/**
 * Flies to the point of the scene at a place of the canvas, if there is one, and turns around it from then on.
 * @param {import("./webplayer.js").WebPlayer} player
 * @param {number} xPx from the left, in CSS pixels
 * @param {number} yPx from the top
 */
export function focusAt(player, xPx, yPx) {
  const point = scenePointAt(player.view, xPx, yPx);
  if (point === null) return;
  player.motion?.focusOn(point);
  player.moved();
}
