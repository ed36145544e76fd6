import { startWorker } from "../playback/playerworkers.js";
import { Painter } from "../renderer/painter.js";
import { Orbit } from "../view/orbit.js";
import { nearOf } from "../view/pose.js";
import { CanvasSize, FrameLoop } from "./surface.js";

/** If a request waits for longer than this, the browser is not drawing this page. */
const IDLE_MS = 100;

/** @typedef {import("../playback/messages.js").OpenManifest} OpenManifest */
/** @typedef {import("../playback/messages.js").SortedFrame} SortedFrame */
/** @typedef {import("../stereo/headset.js").Headset} Headset */
/** @typedef {(scene: import("../view/orbit.js").OrbitScene, orbit: Orbit) => import("../view/cameramotion.js").CameraMotion} MakeMotion */

/**
 * Durations of the last frame, and the picture rate.
 * @typedef {object} Timings
 * @property {number} sortMs @property {number} uploadMs
 * @property {number} drawMs time to issue the draw calls; the device draws later
 * @property {number} framesPerS
 */

/** The worker that takes the frames for a picture: it sorts. */
export class Sorter {
  /** @type {"none" | "waiting" | "due"} its request; "due": it is answered at once */
  #request = "none";
  /** Number of the last request; answers to earlier requests may still arrive. */
  #lastRequest = 0;
  /** Whether Gaussians were in motion at the last request. */
  #isMoving = false;
  /** @type {number[]} (4, 4) world to camera of the last request */
  requestedW2c = [];
  worker = startWorker(new URL("../playback/sortworker.js", import.meta.url));

  /** @param {(sorted: SortedFrame) => void} onSorted */
  constructor(onSorted) {
    this.worker.onmessage = (/** @type {MessageEvent<SortedFrame>} */ { data }) => {
      if (data.request === this.#lastRequest) this.#request = "none";
      onSorted(data);
    };
  }

  /** Whether the last order is up to date with the camera, and no frame has arrived since. */
  get isSettled() {
    return this.#request === "waiting";
  }

  /**
   * Makes sure that the sorter has a request. It answers when it has a new frame, or at once if the camera
   * has moved; at most one request of the second kind is pending.
   * @param {number[]} w2c (4, 4) world to camera @param {number} nearM
   * @param {boolean} isMoving whether Gaussians are in motion; the order is then that of half the way, and
   *   includes Gaussians that fade out
   */
  requestOrder(w2c, nearM, isMoving) {
    const isMoved =
      isMoving !== this.#isMoving || w2c.some((entry, i) => entry !== this.requestedW2c[i]);
    if (this.#request === "due" || (this.#request === "waiting" && !isMoved)) return;
    this.#lastRequest += 1;
    const view = { w2c, nearM, isMoving, request: this.#lastRequest };
    /** @type {import("../playback/messages.js").ToSorter} */
    const message = { view, isMoved };
    this.worker.postMessage(message);
    this.#request = isMoved ? "due" : "waiting";
    this.requestedW2c = w2c;
    this.#isMoving = isMoving;
  }
}

/**
 * The scene on a canvas, or on a headset: requests draw orders from the sorter, and draws when the
 * picture would change.
 *
 * Events: `frame` (a sorted frame is on the device; `lastSeeks`), `drawing` (the browser lets the page
 * draw), `headset`, `select`, `lost`, `restored`, `gone` (of the WebGL context).
 */
export class SceneView extends EventTarget {
  /** Whether pictures between two frames show motion, if the screen is faster than the stream. */
  interpolates = true;
  /** @type {import("../renderer/smoothing.js").Smoothing | null} null until a stream plays */
  smoothing = null;
  #isLoading = false;
  loop = new FrameLoop((nowMs) => this.#drawOnCanvas(nowMs));
  /** @type {Orbit | null} the camera's position and direction; null until a stream is open */
  orbit = null;
  /** @type {import("../view/cameramotion.js").CameraMotion | null} null until `steer`, or until a stream is open */
  motion = null;
  /** @type {typeof import("../renderer/colourpass.js").ColourPass | null} null until a stream needs it */
  ColourPass = null;
  /** @type {MakeMotion | null} */
  makeMotion = null;
  /** @type {OpenManifest | null} of the open stream */
  manifest = null;
  /** @type {Sorter | null} */
  sorter = null;
  /** @type {SortedFrame | null} received since the last picture, and not uploaded yet */
  sorted = null;
  /** @type {Timings} */
  timings = { sortMs: 0, uploadMs: 0, drawMs: 0, framesPerS: 0 };
  /** The frame that the renderer holds; -1 before the first. */
  shownFrame = -1;
  /** Number of seeks that had been made when the worker showed that frame. */
  lastSeeks = 0;
  /** @type {typeof import("../stereo/eyes.js").eyesAt | null} two pictures in place of one, if set */
  eyesAt = null;
  /** @type {Headset | null} set while a headset shows the scene in place of the canvas */
  headset = null;
  isDisposed = false;
  /** Whether the renderer lacks Gaussians, so that only a whole frame can be drawn. */
  isEmpty = true;
  needsDrawing = false;
  drawnMs = 0;

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {import("./streamsession.js").StreamSession} session gives the times when frames are due
   */
  constructor(canvas, session) {
    super();
    this.session = session;
    /** @type {HTMLCanvasElement} */ this.canvas = canvas;
    this.painter = new Painter(canvas);
    this.size = new CanvasSize(canvas, () => this.redraw());
    this.painter.addEventListener("lost", () => this.notify("lost"));
    this.painter.addEventListener("gone", () => this.notify("gone"));
    this.painter.addEventListener("restored", () => {
      this.isEmpty = true;
      this.notify("restored");
      this.loop.request();
    });
  }

  /** Loads what only some streams need. @param {OpenManifest} manifest */
  async load(manifest) {
    if (manifest.shDegree < 2) return;
    ({ ColourPass: this.ColourPass } = await import("../renderer/colourpass.js"));
  }

  /**
   * Prepares to draw another stream, or the same one again, after `load`. Throws a RendererError without WebGL2, or if
   * the device cannot hold the stream.
   * @param {OpenManifest} manifest @param {Sorter} sorter
   */
  show(manifest, sorter) {
    const { painter, size } = this;
    this.orbit ??= new Orbit(manifest); // a player that was parked keeps its camera
    this.motion ??= this.makeMotion?.(manifest, this.orbit) ?? null;
    this.manifest = manifest;
    this.sorter = sorter;
    this.isEmpty = true;
    // Later, this call would block the page until the device has finished all work queued by then.
    painter.context.fit(size.widthPx, size.heightPx);
    painter.prepare({
      numSlots: manifest.numGs,
      shDegree: manifest.shDegree,
      ColourPass: manifest.shDegree < 2 ? null : this.ColourPass,
      nearM: Math.min(manifest.nearM, ...manifest.cameraNearM), // the order omits Gaussians nearer than that
      lattices: manifest.lattices,
    });
    this.headset?.replace();
    this.redraw();
  }

  /** @param {SortedFrame} sorted @param {boolean} isHeld whether to draw even if the page is not drawn */
  receive(sorted, isHeld) {
    this.sorted = this.sorted === null ? sorted : joined(this.sorted, sorted);
    // Smoothing is loaded after the first picture, so as not to delay it.
    if (this.interpolates && !this.isEmpty && !this.#isLoading) this.#loadSmoothing();
    if (this.headset !== null) return;
    if (isHeld && this.loop.waitedMs > IDLE_MS) this.loop.flush();
    else this.loop.request();
  }

  async #loadSmoothing() {
    this.#isLoading = true;
    try {
      const { Smoothing } = await import("../renderer/smoothing.js");
      this.smoothing = new Smoothing(this);
    } catch (error) {
      console.warn("swings: there is no motion between frames, its code is missing:", error);
    }
  }

  /** Draws again, because the camera, the size or the number of pictures has changed. */
  redraw() {
    this.needsDrawing = true;
    this.loop.request();
  }

  /** Whether the next picture would be the same as the last one. */
  get isSettled() {
    const isMoving = this.smoothing?.isMoving ?? false;
    return this.sorted === null && !isMoving && (this.sorter?.isSettled ?? true);
  }

  /** Lets viewers move the camera, of this stream and of later ones. @param {MakeMotion} make */
  steer(make) {
    this.makeMotion = make;
    if (this.manifest !== null && this.orbit !== null)
      this.motion = make(this.manifest, this.orbit);
  }

  /** The current camera, with the size of the canvas, or of half the canvas side by side. */
  get camera() {
    const { orbit, manifest, size } = this;
    const widthPx = this.eyesAt !== null ? Math.max(1, size.widthPx >> 1) : size.widthPx;
    if (orbit === null || manifest === null) return null;
    return orbit.camera(manifest.defaultCamera, widthPx, size.heightPx);
  }

  /**
   * Shows the scene on a headset, at its true scale, from the camera's position. Needs a recent user
   * gesture. Throws a HeadsetError.
   */
  async enterHeadset() {
    const { enterHeadset } = await import("../stereo/headset.js");
    return enterHeadset(this);
  }

  /** @param {number} nowMs */
  #drawOnCanvas(nowMs) {
    this.notify("drawing");
    if (this.headset !== null) return;
    if (this.motion?.step(nowMs)) this.redraw();
    const { camera, orbit } = this;
    if (camera === null || orbit === null) return;
    const viewpoint = this.eyesAt?.(camera, orbit.centre) ?? oneEye(camera);
    this.draw(viewpoint, nowMs);
  }

  /**
   * Uploads new data, and draws if the picture would change.
   * @param {import("../stereo/eyes.js").Viewpoint} viewpoint @param {number} nowMs
   */
  draw(viewpoint, nowMs) {
    const { manifest, painter, size } = this;
    if (manifest === null) return;
    if (this.sorted !== null) this.#upload(this.sorted);
    const isMoving = this.smoothing?.step(nowMs) ?? false;
    this.sorter?.requestOrder(viewpoint.w2c, nearOf(manifest, viewpoint), isMoving);
    if (!this.needsDrawing || this.isEmpty) return;
    this.needsDrawing = false;
    const beganMs = performance.now();
    painter.draw(viewpoint, size.widthPx, size.heightPx);
    this.timings.drawMs = performance.now() - beganMs;
    const sinceMs = nowMs - this.drawnMs;
    this.drawnMs = nowMs;
    if (sinceMs > 0) {
      const share = this.timings.framesPerS ? 0.1 : 1;
      this.timings.framesPerS += share * (1000 / sinceMs - this.timings.framesPerS);
    }
  }

  /** @param {SortedFrame} sorted */
  #upload({ updates, order, frame, seeks, sortMs, isWhole }) {
    this.sorted = null;
    const { renderer } = this.painter;
    if (renderer === null || (this.isEmpty && !isWhole)) return;
    this.isEmpty = false;
    const beganMs = performance.now();
    this.smoothing?.attach(renderer);
    renderer.update(updates, order, frame);
    this.timings.uploadMs = performance.now() - beganMs;
    this.timings.sortMs = sortMs;
    this.needsDrawing = true;
    const isOther = frame !== this.shownFrame;
    this.shownFrame = frame;
    this.lastSeeks = seeks;
    this.dispatchEvent(new CustomEvent("frame", { detail: isOther }));
  }

  /** @param {string} type */
  notify(type) {
    this.dispatchEvent(new Event(type));
  }

  /** Frees the device's memory; the canvas keeps its picture, and the camera stays. */
  release() {
    this.loop.stop();
    this.painter.clear();
    this.sorter = null;
    this.sorted = null;
    this.isEmpty = true;
  }

  /** Closes the stream; its last picture stays until the next one. */
  close() {
    this.release();
    this.manifest = null;
    this.orbit = null;
    this.motion = null;
    this.shownFrame = -1;
  }

  dispose() {
    this.isDisposed = true;
    this.headset?.end();
    this.close();
    this.size.dispose();
    this.painter.dispose();
  }
}

/**
 * Merges two answers of the sorter: the later one holds only the changes since the earlier one, and both
 * can arrive before the browser lets the page draw.
 * @param {SortedFrame} earlier @param {SortedFrame} later @returns {SortedFrame}
 */
function joined(earlier, later) {
  if (later.isWhole) return later;
  const updates = [...earlier.updates, ...later.updates];
  return { ...later, isWhole: earlier.isWhole, updates };
}

/**
 * One eye on the whole canvas.
 * @param {import("../format/manifest.js").Camera} camera @returns {import("../stereo/eyes.js").Viewpoint}
 */
function oneEye(camera) {
  return { w2c: camera.w2c, views: [{ camera, corner: { xPx: 0, yPx: 0 } }], framebuffer: null };
}
