import { poseOf, worldToCamera } from "../view/pose.js";
import { middleOf } from "./eyes.js";
import { Placement } from "./placement.js";
import { pinholeOf, poseOfTransform } from "./xrview.js";

/** @typedef {import("../view/pose.js").Pose} Pose */

const MODE = "immersive-vr";

/** A headset cannot be used; the message says what the user can do. */
export class HeadsetError extends Error {
  /** @param {string} message */
  constructor(message) {
    super(message);
    this.name = "HeadsetError";
  }
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
 * @param {Headset} headset
 * @param {import("../element/sceneview.js").SceneView} view
 * @param {number} nowMs
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
  /**
   * Begins a session. Needs a recent user gesture. Throws a HeadsetError.
   * @param {WebGL2RenderingContext} gl
   */
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

  /**
   * @param {XRSession} session
   * @param {XRWebGLLayer} layer
   * @param {XRReferenceSpace} space
   */
  constructor(session, layer, space) {
    super();
    this.session = session;
    this.layer = layer;
    this.space = space;
    /** @type {Placement | null} null: the next pose of the head makes it */
    this.placement = null;
    /** @type {import("./eyes.js").Viewpoint | null} */
    this.last = null;
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
   * @param {XRFrame} frame
   * @param {Pose} start the viewer's first pose
   * @param {import("../view/vectors.js").Vector} up of the scene, unit
   */
  viewpoint(frame, start, up) {
    const head = frame.getViewerPose(this.space);
    if (!head) return this.last;
    this.placement ??= new Placement(poseOfTransform(head.transform.matrix), start, up);
    const poses = [];
    const views = [];
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
