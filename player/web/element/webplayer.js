import { SplatRenderer } from "../renderer/splatrenderer.js";
import { RendererError } from "../renderer/program.js";
import { edgeFrame } from "../source/liveedge.js";
import { Orbit } from "../view/orbit.js";

/**
 * How a play stands.
 * @typedef {object} PlayState
 * @property {number} frame that shows
 * @property {number} endFrame the first one that is not there
 * @property {boolean} playing
 * @property {boolean} waiting for what has not come
 * @property {number} stalls
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

/**
 * A worker of ours, wherever this page comes from: a page of another origin may not start one itself.
 * @param {string} path beside this file
 */
function startWorker(path) {
  const url = new URL(path, import.meta.url).href;
  const script = new Blob([`import ${JSON.stringify(url)};`], { type: "text/javascript" });
  const blobUrl = URL.createObjectURL(script);
  const worker = new Worker(blobUrl, { type: "module" });
  URL.revokeObjectURL(blobUrl);
  return worker;
}

/**
 * Plays a stream on a canvas. Network and decoding run in one worker, sorting in another; this thread
 * uploads and draws.
 *
 * Events: `opened`, `state` (this.state), `grown` (numFrames or live has changed), `ended`, `trouble`
 * and `failed` (detail: a message, or null when the trouble is over).
 */
export class WebPlayer extends EventTarget {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    super();
    this.canvas = canvas;
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false });
    if (gl === null) {
      throw new RendererError("This browser has no WebGL2; try a current one, or another device");
    }
    this.gl = gl;
    /** @type {SplatRenderer | null} */
    this.renderer = null;
    /** @type {Orbit | null} */
    this.orbit = null;
    /** @type {any} what the stream's manifest says */
    this.manifest = null;
    this.numFrames = 0;
    /** Whether the stream may still grow. */
    this.live = false;
    /** @type {PlayState} */
    this.state = {
      frame: 0,
      endFrame: 0,
      playing: false,
      waiting: true,
      stalls: 0,
      rateBps: null,
      receivedBytes: 0,
      decodeMs: 0,
    };
    /** @type {Timings} */
    this.timings = { sortMs: 0, uploadMs: 0, drawMs: 0, framesPerS: 0 };
    this.shownFrame = -1;
    this.pixelRatio = Math.min(2, globalThis.devicePixelRatio || 1);
    /** @type {Worker | null} */
    this.worker = null;
    /** @type {Worker | null} */
    this.sorter = null;
    /** @type {"none" | "waits" | "due"} whether the sorter has a request, and will answer at once */
    this.asked = "none";
    this.needsOrder = true;
    this.needsDrawing = false;
    /** @type {any} an order that came, with what is new, until the next picture */
    this.sorted = null;
    this.drawnMs = 0;
    this.loopId = requestAnimationFrame((ms) => this.#tick(ms));
  }

  /** Opens the stream whose folder is at `src`. @param {string} src */
  open(src) {
    this.close();
    const base = new URL(src.endsWith("/") ? src : `${src}/`, document.baseURI).href;
    const channel = new MessageChannel();
    this.sorter = startWorker("../playback/sortworker.js");
    this.sorter.onmessage = ({ data }) => {
      this.asked = "none";
      this.sorted = data;
    };
    this.sorter.postMessage({ port: channel.port2 }, [channel.port2]);
    this.worker = startWorker("../playback/playworker.js");
    this.worker.onmessage = ({ data }) => this.#heard(data);
    this.worker.onerror = (event) => this.#say("failed", `The player broke: ${event.message}`);
    this.worker.postMessage({ kind: "open", base, port: channel.port1 }, [channel.port1]);
  }

  /** @param {boolean} playing */
  setPlaying(playing) {
    this.worker?.postMessage({ kind: "play", playing });
    this.state = { ...this.state, playing };
    this.#say("state");
  }

  /** @param {number} frame */
  seek(frame) {
    this.worker?.postMessage({ kind: "seek", frame });
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
    this.needsOrder = true;
    this.needsDrawing = true;
  }

  /** @param {any} data */
  #heard(data) {
    switch (data.kind) {
      case "opened":
        this.manifest = data.manifest;
        this.numFrames = data.numFrames;
        this.live = data.manifest.live;
        this.orbit = new Orbit(data.manifest);
        try {
          this.renderer?.close();
          this.renderer = new SplatRenderer(this.gl, {
            numSlots: data.manifest.numGs,
            shDegree: data.manifest.shDegree,
            lattices: data.manifest.lattices,
          });
        } catch (error) {
          if (!(error instanceof RendererError)) throw error;
          this.#say("failed", error.message);
          return;
        }
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

  /** The camera as it is now, as large as the canvas. */
  get camera() {
    const { canvas, orbit, manifest } = this;
    return orbit?.camera(manifest.defaultCamera, canvas.width, canvas.height) ?? null;
  }

  /** @param {number} nowMs */
  #tick(nowMs) {
    this.loopId = requestAnimationFrame((ms) => this.#tick(ms));
    this.#fitCanvas();
    const { camera, renderer } = this;
    if (camera === null || renderer === null) return;
    if (this.sorted !== null) this.#takeIn(renderer);
    this.#askForOrder(camera);
    if (!this.needsDrawing || this.shownFrame < 0) return;
    this.needsDrawing = false;
    const beganMs = performance.now();
    renderer.draw(camera);
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
   * @param {import("../format/camera.js").Camera} camera
   */
  #askForOrder(camera) {
    if (this.asked === "due" || (this.asked === "waits" && !this.needsOrder)) return;
    const view = { w2c: camera.w2c, nearM: this.manifest.nearM };
    this.sorter?.postMessage({ view, isMoved: this.needsOrder });
    this.asked = this.needsOrder ? "due" : "waits";
    this.needsOrder = false;
  }

  /** @param {SplatRenderer} renderer */
  #takeIn(renderer) {
    const { updates, order, frame, sortMs } = this.sorted;
    this.sorted = null;
    const beganMs = performance.now();
    renderer.update(updates, order);
    this.timings.uploadMs = performance.now() - beganMs;
    this.timings.sortMs = sortMs;
    this.shownFrame = frame;
    this.needsDrawing = true;
  }

  #fitCanvas() {
    const { canvas, pixelRatio } = this;
    const widthPx = Math.max(1, Math.round(canvas.clientWidth * pixelRatio));
    const heightPx = Math.max(1, Math.round(canvas.clientHeight * pixelRatio));
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
    this.shownFrame = -1;
    this.live = false;
  }

  /** Ends all. */
  dispose() {
    cancelAnimationFrame(this.loopId);
    this.close();
  }
}
