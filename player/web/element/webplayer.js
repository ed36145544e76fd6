import { startWorker } from "../playback/startworker.js";
import { SplatRenderer } from "../renderer/splatrenderer.js";
import { RendererError } from "../renderer/program.js";
import { edgeFrame } from "../source/liveedge.js";
import { EYE_DISTANCE_M, oneEye, sideBySide } from "../stereo/eyes.js";
import { Headset } from "../stereo/headset.js";
import { Orbit } from "../view/orbit.js";
import { poseOf } from "../view/pose.js";
import { length, subtract } from "../view/vectors.js";

/** Side by side, the plane of the screen comes no nearer to the eyes. */
const LEAST_FOCUS_M = 0.5;

/**
 * How a play stands.
 * @typedef {object} PlayState
 * @property {number} frame that shows
 * @property {number} endFrame the first one that is not there
 * @property {boolean} playing
 * @property {boolean} waiting for what has not come
 * @property {number} stalls
 * @property {number} layers of what shows
 * @property {number | null} rateBps estimated throughput
 * @property {number} receivedBytes
 * @property {number} decodeMs of the last frame
 */

/**
 * What took how long, of the last frame.
 * @typedef {object} Timings
 * @property {number} sortMs
 * @property {number} uploadMs
 * @property {number} drawMs until the calls were made; the device draws later
 * @property {number} framesPerS
 */

/** @type {PlayState} of a stream of which nothing is there yet */
const START = {
  frame: 0,
  endFrame: 0,
  playing: false,
  waiting: true,
  stalls: 0,
  layers: 0,
  rateBps: null,
  receivedBytes: 0,
  decodeMs: 0,
};

/**
 * Plays a stream on a canvas. Network and decoding run in one worker, sorting in another; this thread
 * uploads and draws.
 *
 * Events: `opened`, `state` (this.state), `shown` (another frame), `seeking`, `seeked`, `grown`
 * (numFrames or live has changed), `ended`, `headset` (it was put on, hidden or taken off), `select`
 * (its trigger was pulled), `trouble` and `failed` (detail: a message, or null when the trouble is
 * over).
 */
export class WebPlayer extends EventTarget {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    super();
    this.canvas = canvas;
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false });
    if (gl === null) {
      throw new RendererError(
        "This browser does not support WebGL2; use a current browser or another device",
      );
    }
    this.gl = gl;
    /** @type {SplatRenderer | null} */
    this.renderer = null;
    /** @type {Orbit | null} */
    this.orbit = null;
    /** @type {any} what the stream's manifest says */
    this.manifest = null;
    this.numFrames = 0;
    /** URL of the stream's folder, with a slash at its end. */
    this.base = "";
    /** Whether the stream may still grow. */
    this.live = false;
    /** @type {PlayState} */
    this.state = START;
    /** @type {Timings} */
    this.timings = { sortMs: 0, uploadMs: 0, drawMs: 0, framesPerS: 0 };
    this.shownFrame = -1;
    this.isSeeking = false;
    /** Counts seeks: what was on its way when the last one began is not what it asked for. */
    this.seeks = 0;
    this.soughtFrame = 0;
    this.pixelRatio = Math.min(2, globalThis.devicePixelRatio || 1);
    /** What the page gives the canvas; to ask the canvas itself would lay the page out at once. */
    this.sizePx = [canvas.clientWidth, canvas.clientHeight];
    this.resizing = new ResizeObserver(([{ contentRect }]) => {
      this.sizePx = [contentRect.width, contentRect.height];
    });
    this.resizing.observe(canvas);
    this.isSideBySide = false;
    this.eyeDistanceM = EYE_DISTANCE_M;
    /** @type {Headset | null} while a headset shows the scene, and the canvas does not */
    this.headset = null;
    /** @type {Worker | null} */
    this.worker = null;
    /** @type {Worker | null} */
    this.sorter = null;
    /** @type {"none" | "waits" | "due"} whether the sorter has a request, and will answer at once */
    this.asked = "none";
    /** @type {number[]} (4, 4) world to camera, as the sorter last heard of it */
    this.orderedW2c = [];
    this.needsDrawing = false;
    /** @type {any} an order that came, with what is new, until the next picture */
    this.sorted = null;
    this.drawnMs = 0;
    this.isDisposed = false;
    this.loopId = requestAnimationFrame((ms) => this.#tick(ms));
  }

  /**
   * Opens the stream whose folder is at `src`.
   * @param {string} src
   * @param {number | null} maxGaussians a stream of more fails; null for the default, 2^22
   */
  open(src, maxGaussians = null) {
    this.close();
    const base = new URL(src.endsWith("/") ? src : `${src}/`, document.baseURI).href;
    const channel = new MessageChannel();
    this.sorter = startWorker(new URL("../playback/sortworker.js", import.meta.url));
    this.sorter.onmessage = ({ data }) => {
      this.asked = "none";
      this.sorted = data;
    };
    this.sorter.postMessage({ port: channel.port2 }, [channel.port2]);
    this.worker = startWorker(new URL("../playback/playworker.js", import.meta.url));
    this.worker.onmessage = ({ data }) => this.#heard(data);
    this.worker.onerror = ({ message }) => {
      // A worker that never began says nothing.
      const why =
        message ?? "one of its scripts was not loaded; see the errors in the browser's console";
      this.#say("failed", `The player failed: ${why}`);
    };
    const { port1 } = channel;
    this.worker.postMessage({ kind: "open", base, maxGaussians, port: port1 }, [port1]);
  }

  /** @param {boolean} playing */
  setPlaying(playing) {
    this.worker?.postMessage({ kind: "play", playing });
    this.state = { ...this.state, playing };
    this.#say("state");
  }

  /** @param {number} frame */
  seek(frame) {
    this.soughtFrame = Math.max(0, Math.min(this.numFrames - 1, frame));
    this.isSeeking = true;
    this.seeks += 1;
    this.worker?.postMessage({ kind: "seek", frame: this.soughtFrame, seeks: this.seeks });
    this.#say("seeking");
  }

  /** Goes on to the edge of a live stream. */
  seekEdge() {
    const edge = edgeFrame(this.manifest, this.numFrames);
    if (this.state.frame < edge) this.seek(edge);
  }

  /** @param {number} rate */
  setRate(rate) {
    this.worker?.postMessage({ kind: "rate", rate });
  }

  /** @param {boolean} loop */
  setLoop(loop) {
    this.worker?.postMessage({ kind: "loop", loop });
  }

  /** Shows this many layers at most. @param {number} most */
  setLayers(most) {
    this.worker?.postMessage({ kind: "layers", most });
  }

  /** The camera has moved. */
  moved() {
    this.needsDrawing = true;
  }

  /** @param {any} data */
  #heard(data) {
    switch (data.kind) {
      case "opened":
        this.manifest = data.manifest;
        this.numFrames = data.numFrames;
        this.base = data.base;
        this.live = data.manifest.live;
        this.orbit = new Orbit(data.manifest);
        try {
          this.renderer?.close();
          this.renderer = new SplatRenderer(this.gl, {
            numSlots: data.manifest.numGs,
            shDegree: data.manifest.shDegree,
            nearM: data.manifest.nearM,
            lattices: data.manifest.lattices,
          });
        } catch (error) {
          if (!(error instanceof RendererError)) throw error;
          this.#say("failed", error.message);
          return;
        }
        this.headset?.replace();
        this.moved();
        this.#say("opened");
        break;
      case "grown":
        this.numFrames = data.numFrames;
        this.live = data.live;
        this.#say("grown");
        break;
      case "state":
        this.state = data;
        this.#say("state");
        break;
      case "ended":
        this.state = { ...this.state, playing: false };
        this.#say("ended");
        break;
      default:
        this.#say(data.kind, data.message);
    }
  }

  /**
   * @param {string} type
   * @param {string | null} [detail]
   */
  #say(type, detail = null) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }

  /** The camera as it is now, as large as the canvas, or as one half of it side by side. */
  get camera() {
    const { canvas, orbit, manifest } = this;
    const widthPx = this.isSideBySide ? Math.max(1, canvas.width >> 1) : canvas.width;
    return orbit?.camera(manifest.defaultCamera, widthPx, canvas.height) ?? null;
  }

  /** Shows two pictures, of the left eye and of the right one, or one. @param {boolean} isOn */
  setSideBySide(isOn) {
    this.isSideBySide = isOn;
    this.moved();
  }

  /**
   * Shows the scene on a headset, as large as it is, from where the camera stands. A person must have
   * pressed something just now. Throws a HeadsetError.
   */
  async enterHeadset() {
    const headset = await Headset.begin(this.gl);
    if (this.isDisposed) {
      headset.end();
      return;
    }
    headset.addEventListener("select", () => this.#say("select"));
    headset.addEventListener("visibility", () => this.#say("headset"));
    headset.addEventListener("ended", () => {
      this.headset = null;
      this.moved();
      this.#say("headset");
    });
    headset.run((ms, frame) => this.#drawInHeadset(headset, ms, frame));
    this.headset = headset;
    this.#say("headset");
  }

  /** @param {number} nowMs */
  #tick(nowMs) {
    this.loopId = requestAnimationFrame((ms) => this.#tick(ms));
    if (this.headset !== null) return;
    this.#fitCanvas();
    const { camera, orbit } = this;
    if (camera === null || orbit === null) return;
    const focusM = length(subtract(orbit.centre, poseOf(camera).position));
    const viewpoint = this.isSideBySide
      ? sideBySide(camera, this.eyeDistanceM, Math.max(focusM, LEAST_FOCUS_M))
      : oneEye(camera);
    this.#draw(viewpoint, nowMs);
  }

  /**
   * @param {Headset} headset
   * @param {number} nowMs
   * @param {XRFrame} frame
   */
  #drawInHeadset(headset, nowMs, frame) {
    const { camera, orbit } = this;
    if (camera === null || orbit === null) return;
    const viewpoint = headset.viewpoint(frame, poseOf(camera), orbit.up);
    if (viewpoint === null) return;
    this.needsDrawing = true; // a headset starts each picture from nothing
    this.#draw(viewpoint, nowMs);
  }

  /**
   * Takes in what is new, and draws if there is something else to see.
   * @param {import("../stereo/eyes.js").Viewpoint} viewpoint
   * @param {number} nowMs
   */
  #draw({ w2c, views, framebuffer }, nowMs) {
    const { renderer } = this;
    if (renderer === null) return;
    if (this.sorted !== null) this.#takeIn(renderer);
    this.#askForOrder(w2c);
    if (!this.needsDrawing || this.shownFrame < 0) return;
    this.needsDrawing = false;
    const beganMs = performance.now();
    for (const { camera, corner } of views) renderer.draw(camera, corner, framebuffer);
    this.timings.drawMs = performance.now() - beganMs;
    const sinceMs = nowMs - this.drawnMs;
    this.drawnMs = nowMs;
    if (sinceMs > 0) {
      const share = this.timings.framesPerS ? 0.1 : 1;
      this.timings.framesPerS += share * (1000 / sinceMs - this.timings.framesPerS);
    }
  }

  /**
   * The sorter always has a request: it answers when it has a new frame, or at once if the camera has
   * moved. One of the second kind is underway at most.
   * @param {number[]} w2c (4, 4) world to camera
   */
  #askForOrder(w2c) {
    const isMoved = w2c.some((entry, i) => entry !== this.orderedW2c[i]);
    if (this.asked === "due" || (this.asked === "waits" && !isMoved)) return;
    this.sorter?.postMessage({ view: { w2c, nearM: this.manifest.nearM }, isMoved });
    this.asked = isMoved ? "due" : "waits";
    this.orderedW2c = w2c;
  }

  /** @param {SplatRenderer} renderer */
  #takeIn(renderer) {
    const { updates, order, frame, seeks, sortMs } = this.sorted;
    this.sorted = null;
    const beganMs = performance.now();
    renderer.update(updates, order);
    this.timings.uploadMs = performance.now() - beganMs;
    this.timings.sortMs = sortMs;
    this.needsDrawing = true;
    const isNew = frame !== this.shownFrame;
    this.shownFrame = frame;
    if (isNew) this.#say("shown");
    if (seeks === this.seeks && this.isSeeking) {
      this.isSeeking = false;
      this.#say("seeked");
    }
  }

  #fitCanvas() {
    const { canvas, pixelRatio, sizePx } = this;
    const [widthPx, heightPx] = sizePx.map((px) => Math.max(1, Math.round(px * pixelRatio)));
    if (canvas.width === widthPx && canvas.height === heightPx) return;
    canvas.width = widthPx;
    canvas.height = heightPx;
    this.moved();
  }

  /** Ends the play; another stream can be opened. */
  close() {
    this.worker?.terminate();
    this.sorter?.terminate();
    this.worker = null;
    this.sorter = null;
    this.renderer?.close();
    this.renderer = null;
    this.orbit = null;
    this.sorted = null;
    this.asked = "none";
    this.orderedW2c = [];
    this.shownFrame = -1;
    this.isSeeking = false;
    this.manifest = null;
    this.state = START;
    this.live = false;
  }

  /** Ends all. */
  dispose() {
    this.isDisposed = true;
    cancelAnimationFrame(this.loopId);
    this.resizing.disconnect();
    this.headset?.end();
    this.close();
  }
}
