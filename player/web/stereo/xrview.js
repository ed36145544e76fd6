/** What WebXR says of eyes and heads, as poses and cameras. Matrices of WebXR go column by column. */

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
 * The pinhole camera that projects as an eye of a headset does. Most eyes see farther to one side
 * than to the other: the principal point is then beside the middle.
 * @param {ArrayLike<number>} projection (4, 4) of an XRView, without skew, as headsets have it
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
