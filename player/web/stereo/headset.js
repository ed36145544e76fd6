/** A session of WebXR: its eyes as cameras, and its space in the scene. WebXR's matrices are column-major. */

import { poseOf, worldToCamera } from "../view/pose.js";
import { add, cross, dot, length, subtract, times, unit } from "../view/vectors.js";
import { middleOf } from "./eyes.js";

/** @typedef {import("../view/pose.js").Pose} Pose */

/**
 * A pose in WebXR's space, whose axes are right, up and back.
 * @param {ArrayLike<number>} matrix (4, 4) of an XRRigidTransform @returns {Pose}
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
 * @param {number} widthPx @param {number} heightPx
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

/** @typedef {import("../view/vectors.js").Vector} Vector */

/** The up axis of a headset's space. */
const XR_UP = [0, 1, 0];

/**
 * The placement of a headset's space in the world of a stream. Both are in metres, so the space is
 * rotated and moved, but not scaled. Up in the headset's space is up in the scene.
 */
export class Placement {
  /**
   * @param {Pose} head in the headset's space; it is placed at `start`, facing the same way
   * @param {Pose} start in the world; its pitch is ignored, because the head determines it
   * @param {Vector} up of the scene, unit
   */
  constructor(head, start, up) {
    /** @type {Vector[]} */ this.from = upright(head, XR_UP);
    /** @type {Vector[]} */ this.to = upright(start, up);
    /** @type {Vector} */ this.head = head.position;
    /** @type {Vector} */ this.start = start.position;
  }

  /** Converts a direction from the headset's space to the world. @param {Vector} a */
  direction(a) {
    return this.to.map((axis, i) => times(axis, dot(this.from[i], a))).reduce(add);
  }

  /** Converts a pose from the headset's space to the world. @param {Pose} pose @returns {Pose} */
  pose({ position, right, down, forward }) {
    return {
      position: add(this.start, this.direction(subtract(position, this.head))),
      right: this.direction(right),
      down: this.direction(down),
      forward: this.direction(forward),
    };
  }
}

/**
 * The axes right, up and ahead of an upright viewer with the heading of `pose`.
 * @param {Pose} pose @param {Vector} up unit @returns {Vector[]}
 */
function upright({ forward, down }, up) {
  const level = (/** @type {Vector} */ a) => subtract(a, times(up, dot(a, up)));
  // Looking straight down, the top of the head points ahead; looking straight up, it points back.
  const ahead = level(forward);
  const facing = length(ahead) > 0.1 ? ahead : level(times(down, Math.sign(dot(forward, up))));
  return [unit(cross(facing, up)), up, unit(facing)];
}

const MODE = "immersive-vr";

/** A headset cannot be used; the message says what the user can do. */
export class HeadsetError extends Error {
  name = "HeadsetError";
}

/**
 * Shows the scene of a view on a headset; see SceneView.
 * @param {import("../element/sceneview.js").SceneView} view
 */
export async function enterHeadset(view) {
  const headset = await Headset.begin(view.painter.context.gl);
  if (view.isDisposed) {
    headset.end();
    return;
  }
  headset.addEventListener("select", () => view.notify("select"));
  headset.addEventListener("visibility", () => view.notify("headset"));
  headset.addEventListener("ended", () => {
    view.headset = null;
    view.redraw();
    view.notify("headset");
  });
  headset.run((ms, frame) => drawIn(headset, view, ms, frame));
  view.headset = headset;
  view.notify("headset");
}

/**
 * @param {Headset} headset @param {import("../element/sceneview.js").SceneView} view @param {number} nowMs
 * @param {XRFrame} frame
 */
function drawIn(headset, view, nowMs, frame) {
  const { camera, orbit } = view;
  if (camera === null || orbit === null) return;
  const viewpoint = headset.viewpoint(frame, poseOf(camera), orbit.up);
  if (viewpoint === null) return;
  view.needsDrawing = true; // a headset needs a complete picture every time
  view.draw(viewpoint, nowMs);
}

/**
 * A session on a headset.
 *
 * Events: `select` (the trigger was pulled), `visibility` (this.isHidden), `ended`.
 */
export class Headset extends EventTarget {
  /** Begins a session. Needs a recent user gesture. Throws a HeadsetError. @param {WebGL2RenderingContext} gl */
  static async begin(gl) {
    const { xr } = navigator;
    if (xr === undefined) {
      throw new HeadsetError(
        "WebXR is not available: open this page in the browser of a headset, from an https:// address",
      );
    }
    /** @type {XRSession | undefined} */
    let session;
    try {
      session = await xr.requestSession(MODE);
      await makeCompatible(gl);
      const layer = new XRWebGLLayer(session, gl, {
        alpha: false,
        antialias: false,
        depth: false,
        stencil: false,
      });
      await session.updateRenderState({ baseLayer: layer });
      return new Headset(session, layer, await session.requestReferenceSpace("local"));
    } catch (error) {
      session?.end().catch(() => {}); // it may have ended already
      if (error instanceof HeadsetError) throw error;
      const why = error instanceof Error ? error.message : String(error);
      throw new HeadsetError(
        `VR cannot start: ${why}. Check that the headset is on and that this page may use it, then press VR again`,
      );
    }
  }
  /** @type {Placement | null} null: the next pose of the head makes it */
  placement = null;
  /** @type {import("./eyes.js").Viewpoint | null} */
  last = null;

  /** @param {XRSession} session @param {XRWebGLLayer} layer @param {XRReferenceSpace} space */
  constructor(session, layer, space) {
    super();
    /** @type {XRSession} */ this.session = session;
    /** @type {XRWebGLLayer} */ this.layer = layer;
    /** @type {XRReferenceSpace} */ this.space = space;
    space.addEventListener("reset", () => this.replace());
    session.addEventListener("select", () => this.dispatchEvent(new Event("select")));
    session.addEventListener("end", () => this.dispatchEvent(new Event("ended")));
    session.addEventListener("visibilitychange", () => this.dispatchEvent(new Event("visibility")));
  }

  get isHidden() {
    return this.session.visibilityState === "hidden";
  }

  /** Returns the viewer to the start pose. */
  replace() {
    this.placement = null;
  }

  /**
   * Calls `draw` for each picture; this replaces the page's requestAnimationFrame.
   * @param {(ms: number, frame: XRFrame) => void} draw
   */
  run(draw) {
    const next = (/** @type {number} */ ms, /** @type {XRFrame} */ frame) => {
      this.session.requestAnimationFrame(next);
      draw(ms, frame);
    };
    this.session.requestAnimationFrame(next);
  }

  /**
   * The viewpoint of a frame; the previous one while the head is not tracked, null if not known yet.
   * @param {XRFrame} frame @param {Pose} start the viewer's first pose
   * @param {import("../view/vectors.js").Vector} up of the scene, unit
   */
  viewpoint(frame, start, up) {
    const head = frame.getViewerPose(this.space);
    if (!head) return this.last;
    this.placement ??= new Placement(poseOfTransform(head.transform.matrix), start, up);
    const poses = /** @type {Pose[]} */ ([]);
    const views = /** @type {import("./eyes.js").EyeView[]} */ ([]);
    for (const view of head.views) {
      const port = this.layer.getViewport(view);
      // A device with one eye may report an empty part for the other.
      if (!port || port.width < 1 || port.height < 1) continue;
      const pose = this.placement.pose(poseOfTransform(view.transform.matrix));
      const lens = pinholeOf(view.projectionMatrix, port.width, port.height);
      poses.push(pose);
      views.push({
        camera: { name: view.eye, ...lens, w2c: worldToCamera(pose) },
        corner: { xPx: port.x, yPx: port.y },
      });
    }
    if (views.length === 0) return this.last;
    const w2c = worldToCamera(middleOf(poses));
    this.last = { w2c, views, framebuffer: this.layer.framebuffer };
    return this.last;
  }

  end() {
    this.session.end().catch(() => {}); // it may have ended already
  }
}

/**
 * Lets `gl` draw for the headset. Throws a HeadsetError if the headset uses another graphics device.
 * @param {WebGL2RenderingContext} gl
 */
async function makeCompatible(gl) {
  let isLost = false;
  const lose = () => (isLost = true);
  gl.canvas.addEventListener("webglcontextlost", lose);
  await gl
    .makeXRCompatible()
    .finally(() => gl.canvas.removeEventListener("webglcontextlost", lose));
  if (isLost) {
    throw new HeadsetError(
      "The headset uses another graphics device than this page. Choose the headset's device for the browser in " +
        "the system's settings, restart the browser, and open this page",
    );
  }
}
