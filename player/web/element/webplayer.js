import { RendererError } from "../renderer/program.js";
import { folderUrl } from "../source/addresses.js";
import { isBehind } from "../source/liveedge.js";
import { SceneView, Sorter } from "./sceneview.js";
import { StreamSession } from "./streamsession.js";
import { Sight } from "./surface.js";

/** Maximum number of players out of view that keep their workers and so can resume at once. */
const MOST_WAITING = 4;

/** The page's players out of view, the longest unseen first. @type {Set<{ park: () => void }>} */
const waiting = new Set();

/**
 * Lets a player that is out of view keep its resources, and parks the longest unseen player if there are too many.
 * @param {{ park: () => void }} player
 */
function keepWaiting(player) {
  waiting.delete(player);
  waiting.add(player);
  for (const longest of waiting) {
    if (waiting.size <= MOST_WAITING) break;
    waiting.delete(longest);
    longest.park();
  }
}

/** @param {{ park: () => void }} player one that is in view again, or has ended */
function stopWaiting(player) {
  waiting.delete(player);
}

/**
 * Plays a stream on a canvas. Network and decoding run in one worker, sorting in another; this thread
 * uploads and draws.
 *
 * The workers start when the canvas is first in view, or at once with `preloads`. Out of view, or
 * without a WebGL context, the player pauses, and resumes by itself afterwards. If many players of a
 * page are out of view, the one unseen for the longest is parked: it keeps its last picture, frees
 * everything else, and opens the stream again when it is back in view.
 *
 * Events: `opened`, `state` (this.state), `shown` (another frame), `seeking`, `seeked`, `grown`
 * (numFrames or live has changed), `ended`, `headset` (it was put on, hidden or taken off), `select`
 * (its trigger was pulled), `contextlost`, `contextrestored`, `parked`, `unparked`, `trouble` and
 * `failed` (detail: a message, or null when the trouble is over).
 */
export class WebPlayer extends StreamSession {
  /** Whether `open` starts the workers even if the canvas is not in view. */
  preloads = false;
  isParked = false;
  /** @type {Sorter | null} of the last start */
  sorter = null;
  /** Whether the stream has failed, so that nothing runs until `open`. */
  #hasFailed = false;
  /** Whether a live stream was at its edge when the player went out of view. */
  #wasAtEdge = false;

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    super();
    /** @type {HTMLCanvasElement} */ this.canvas = canvas;
    this.view = new SceneView(canvas, this);
    this.sight = new Sight(canvas, this.view.loop, () => this.#followSight());
    this.addEventListener("state", () => this.sight.check());
    this.#listen();
  }

  #listen() {
    const { view, sight } = this;
    const on = (/** @type {string} */ type, /** @type {(event: any) => void} */ action) =>
      view.addEventListener(type, action);
    on("drawing", () => sight.noteFrame());
    on("frame", (/** @type {CustomEvent<boolean>} */ { detail }) => this.#onFrame(detail));
    on("select", () => this.dispatch("select"));
    on("headset", () => {
      sight.headset = view.headset;
      sight.update();
      this.dispatch("headset");
    });
    on("lost", () => {
      this.#updateMayPlay();
      this.dispatch("contextlost");
      if (this.workers !== null)
        this.dispatch("trouble", "The graphics device was lost; waiting for it");
    });
    on("restored", () => {
      this.resend();
      this.#updateMayPlay();
      this.dispatch("contextrestored");
      this.dispatch("trouble");
    });
    on("gone", () => {
      if (this.workers === null) return; // the next start gets another context
      this.dispatch("trouble");
      this.fail("The graphics device was lost and did not come back; try again");
    });
  }

  /**
   * Opens the stream whose folder, or file, is at `src`.
   * @param {string} src @param {object} [options]
   * @param {number | null} [options.maxGaussians] a larger stream fails; null for the default, 2^22
   * @param {boolean} [options.otherHosts] whether the manifest may refer to hosts other than its own
   * @param {RequestCredentials} [options.credentials] whether requests carry cookies, see `fetch`
   * @param {import("../source/transform.js").TransformRequest} [options.transformRequest] changes each request
   * @param {number | null} [options.bufferMb] limit for the received data that is kept; null for the default, 64
   * @param {boolean} [options.isHeld] whether to fetch no frame until the stream plays or seeks
   */
  open(
    src,
    { maxGaussians = null, otherHosts = false, bufferMb = null, isHeld = false, ...access } = {},
  ) {
    this.close();
    const base = folderUrl(src, document.baseURI);
    const bufferBytes = bufferMb === null ? undefined : 1e6 * bufferMb;
    this.source = { base, maxGaussians, otherHosts, bufferBytes, isHeld, ...access };
    if (this.preloads) this.#start();
    this.#followSight();
  }

  /**
   * Keeps the player running out of view until the returned function is called; used by picture in
   * picture, `captureStream` and the like.
   */
  keepAlive() {
    return this.sight.hold();
  }

  /** Frees everything except the last picture; the player opens again by itself once it is in view. */
  park() {
    if (this.workers === null) return;
    this.#release();
    this.isParked = true;
    this.dispatch("parked");
  }

  /** To be called after the camera was moved. */
  moved() {
    this.view.redraw();
  }

  /**
   * Shows two pictures, for the left and the right eye, or one.
   * @param {typeof import("../stereo/eyes.js").eyesAt | null} eyesAt null: one
   */
  setSideBySide(eyesAt) {
    this.view.eyesAt = eyesAt;
    this.view.redraw();
  }

  /** Shows the scene on a headset; see SceneView. Throws a HeadsetError. */
  enterHeadset() {
    return this.view.enterHeadset();
  }

  #start() {
    const isNew = this.shownFrame < 0 && !this.isSeeking;
    const isAtEdge = this.live && this.wantsPlaying && this.#wasAtEdge;
    const frame = this.isSeeking ? this.soughtFrame : this.shownFrame;
    this.sorter = new Sorter((sorted) => this.view.receive(sorted, this.sight.isHeld));
    this.startWorkers(isNew || isAtEdge ? null : frame, this.sorter.worker);
  }

  #release() {
    stopWaiting(this);
    this.view.release();
    this.stopWorkers();
  }

  /** Starts, pauses or resumes, depending on whether the canvas is in view. */
  #followSight() {
    const { isSeen } = this.sight;
    if (isSeen) stopWaiting(this);
    if (this.source === null || this.#hasFailed) return;
    if (isSeen && this.workers === null) this.#start();
    else if (isSeen && this.live && this.wantsPlaying && this.#wasAtEdge) this.seekEdge();
    if (!isSeen && this.manifest !== null)
      this.#wasAtEdge = this.live && !isBehind(this.manifest, this.numFrames, this.state.frame);
    this.#updateMayPlay();
    if (!isSeen && this.workers !== null) keepWaiting(this);
  }

  /** Whether the graphics device was lost, and nothing can be drawn. */
  get isDeviceLost() {
    return this.view.painter.context.isLost;
  }

  #updateMayPlay() {
    this.allow(this.sight.isSeen && !this.isDeviceLost);
  }

  /** @override @param {boolean} isFirst */
  async onOpened(isFirst) {
    const { manifest, workers, sorter, view } = this;
    if (workers === null || manifest === null || sorter === null) return;
    try {
      await view.load(manifest);
    } catch (error) {
      console.warn("swings: the colours could not be loaded:", error);
      this.fail("Part of the player could not be loaded; check the network and try again");
      return;
    }
    if (workers !== this.workers) return; // closed, or parked
    try {
      view.show(manifest, sorter);
    } catch (error) {
      if (!(error instanceof RendererError)) throw error;
      this.fail(error.message);
      return;
    }
    this.#updateMayPlay();
    super.onOpened(isFirst);
    if (!this.isParked) return;
    this.isParked = false;
    this.dispatch("unparked");
  }

  /** @param {boolean} isOther whether the frame differs from the one shown before */
  #onFrame(isOther) {
    if (isOther) this.dispatch("shown");
    if (this.view.lastSeeks === this.seeks && this.isSeeking) {
      this.isSeeking = false;
      this.dispatch("seeked");
    }
  }

  /** @override @param {string} message */
  fail(message) {
    this.#hasFailed = true;
    this.#release();
    super.fail(message);
  }

  /** @override Ends the play; another stream can be opened afterwards. */
  close() {
    stopWaiting(this);
    super.close();
    this.view.close();
    this.isParked = false;
    this.#hasFailed = false;
    this.#wasAtEdge = false;
  }

  /** Closes the stream and frees everything; the player cannot be used afterwards. */
  dispose() {
    this.sight.dispose();
    this.close();
    this.view.dispose();
  }

  get gl() {
    return this.view.painter.context.gl;
  }

  get renderer() {
    return this.view.painter.renderer;
  }

  /** The camera's motion; null until a stream is open and the controls are loaded. */
  get motion() {
    return this.view.motion;
  }

  get orbit() {
    return this.view.orbit;
  }

  get camera() {
    return this.view.camera;
  }

  /** Width and height of the drawn picture. */
  get pictureSizePx() {
    const { widthPx, heightPx } = this.view.size;
    return [widthPx, heightPx];
  }

  get pixelRatio() {
    return this.view.size.pixelRatio;
  }

  get headset() {
    return this.view.headset;
  }

  get isSideBySide() {
    return this.view.eyesAt !== null;
  }

  get timings() {
    return this.view.timings;
  }

  /** The frame that shows; -1 before the first. */
  get shownFrame() {
    return this.view.shownFrame;
  }

  /** Whether the next picture would be the same as the last one. */
  get isSettled() {
    return this.view.isSettled;
  }
}
