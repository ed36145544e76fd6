import { MAX_IMAGE_PX } from "../constants.js";
import { corrupt } from "./bytes/errors.js";
import { field, integer, number, text } from "./bytes/json.js";

/**
 * A pinhole camera, OpenCV pose (x right, y down, z forward).
 * @typedef {object} Camera
 * @property {string} name
 * @property {number} widthPx
 * @property {number} heightPx
 * @property {number} fxPx
 * @property {number} fyPx
 * @property {number} cxPx
 * @property {number} cyPx
 * @property {number[]} w2c (4, 4) world to camera, row by row, metres
 */

/**
 * A camera of a manifest (FORMAT.md, section 4). Throws a FormatError.
 * @param {unknown} value
 * @returns {Camera}
 */
export function readCamera(value) {
  const w2c = field(value, "w2c");
  if (!Array.isArray(w2c) || w2c.length !== 16) throw corrupt("camera: w2c is not 16 numbers");
  const camera = {
    name: text(field(value, "name"), "camera name"),
    widthPx: integer(field(value, "width_px"), 1, MAX_IMAGE_PX, "width_px"),
    heightPx: integer(field(value, "height_px"), 1, MAX_IMAGE_PX, "height_px"),
    fxPx: number(field(value, "fx_px"), "fx_px"),
    fyPx: number(field(value, "fy_px"), "fy_px"),
    cxPx: number(field(value, "cx_px"), "cx_px"),
    cyPx: number(field(value, "cy_px"), "cy_px"),
    w2c: w2c.map((entry) => number(entry, "w2c")),
  };
  if (camera.fxPx <= 0 || camera.fyPx <= 0) {
    throw corrupt(`camera ${camera.name}: a focal length is not positive`);
  }
  if (!isPose(camera.w2c)) {
    throw corrupt(`camera ${camera.name}: the pose is not a rotation and a translation`);
  }
  return camera;
}

/** Whether a matrix is a rotation and a translation. @param {number[]} m (4, 4) */
function isPose(m) {
  const rows = [0, 4, 8].map((at) => m.slice(at, at + 3));
  const dot = (/** @type {number[]} */ a, /** @type {number[]} */ b) =>
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const isOrthonormal = rows.every((a, i) =>
    rows.every((b, j) => Math.abs(dot(a, b) - (i === j ? 1 : 0)) <= 1e-3),
  );
  const [a, b, c] = rows;
  const cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const lastRow = [0, 0, 0, 1];
  const isAffine = lastRow.every((expected, i) => Math.abs(m[12 + i] - expected) <= 1e-6);
  return isOrthonormal && dot(cross, c) >= 0 && isAffine;
}
