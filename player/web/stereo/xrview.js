/** Converts the eyes and heads of WebXR to poses and cameras. WebXR's matrices are column-major. */

/** @typedef {import("../view/pose.js").Pose} Pose */

/**
 * A pose in WebXR's space, whose axes are right, up and back.
 * @param {ArrayLike<number>} matrix (4, 4) of an XRRigidTransform
 * @returns {Pose}
 */
export function poseOfTransform(matrix) {
  const m = Array.from(matrix);
  return {
    position: m.slice(12, 15),
    right: m.slice(0, 3),
    down: m.slice(4, 7).map((x) => -x),
    forward: m.slice(8, 11).map((x) => -x),
  };
}

/**
 * The pinhole camera with the projection of a headset's eye. Most eyes see farther to one side than to
 * the other, so the principal point is not in the centre.
 * @param {ArrayLike<number>} projection (4, 4) of an XRView; without skew, as in headsets
 * @param {number} widthPx
 * @param {number} heightPx
 * @returns {{ widthPx: number, heightPx: number, fxPx: number, fyPx: number, cxPx: number, cyPx: number }}
 */
export function pinholeOf(projection, widthPx, heightPx) {
  // x_clip = p0 x + p8 z, y_clip = p5 y + p9 z, w_clip = -z, with y up and z back.
  return {
    widthPx,
    heightPx,
    fxPx: (widthPx / 2) * projection[0],
    fyPx: (heightPx / 2) * projection[5],
    cxPx: (widthPx / 2) * (1 - projection[8]),
    cyPx: (heightPx / 2) * (1 + projection[9]),
  };
}
