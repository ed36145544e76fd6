import { Inbetween } from "../renderer/inbetween.js";

/** In-between pictures are drawn if the screen is this many times faster (player/playout/smoothing.py). */
const FASTER = 1.05;
/** The screen's rate is the median of this many intervals, and of at least LEAST_INTERVALS. */
const MOST_INTERVALS = 15;
const LEAST_INTERVALS = 5;
/** The rate is measured again after this time, because a busy page seems to have a slow screen. */
const AGAIN_MS = 3000;

/** @typedef {Omit<import("../playback/messages.js").Line, "line">} Line */

/**
 * Progress, 0 to 1, of the motion from the previous frame to the current one. The motion begins when the
 * frame is due, so the picture is up to one frame late.
 * @param {number} nowMs Unix time
 * @param {Line} line
 * @param {number} frame the current one
 * @param {number} fps
 * @param {number} numFrames after which the stream may have looped
 */
export function shareAt(nowMs, { zeroMs, rate }, frame, fps, numFrames) {
  if (zeroMs === null) return 1;
  const frames = ((nowMs - zeroMs) / 1000) * fps * rate - frame;
  // The line may still be that of an earlier round of the loop.
  const way = frames - numFrames * Math.floor(frames / numFrames + 0.25);
  return Math.max(0, Math.min(1, way));
}

/** Makes a view show motion between frames during playback, on screens faster than the stream. */
export class Smoothing {
  /** Whether the next picture continues the motion. */
  isMoving = false;
  /** @type {number[]} milliseconds between pictures that were requested directly one after the other */
  #intervals = [];
  /** Whether the last picture requested the next one. */
  #isRequested = false;
  #lastMs = 0;
  #measuredMs = -Infinity;
  /** Milliseconds between two refreshes of the screen; while unknown, frames are drawn as they are. */
  #screenMs = Infinity;
  /** The frame of the last picture. */
  #frame = -1;
  /** @type {Inbetween | null} made for the last renderer */
  #inbetween = null;

  /** @param {import("./sceneview.js").SceneView} view */
  constructor(view) {
    this.view = view;
  }

  /**
   * Makes `renderer` draw between frames. Does not wait for the device, which may need a second to
   * compile the programs.
   * @param {import("../renderer/splatrenderer.js").SplatRenderer} renderer
   */
  attach(renderer) {
    if (renderer.inbetween !== null) return;
    try {
      const { manifest } = this.view;
      if (manifest === null) return;
      if (this.#inbetween?.renderer !== renderer)
        this.#inbetween = new Inbetween(renderer, manifest.numGs);
      this.#inbetween.attach();
    } catch (error) {
      if (renderer.gl.isContextLost()) return; // it gets another renderer
      console.warn("swings: this device draws no motion between frames:", error);
      this.view.smoothing = null;
    }
  }

  /**
   * Requests a redraw of this picture, and the next picture, if they continue the motion.
   * @param {number} nowMs time of the picture, on the page's clock
   * @returns {boolean} whether Gaussians that fade out may show
   */
  step(nowMs) {
    const { view } = this;
    const { session, manifest, painter, shownFrame, interpolates } = view;
    const { line, numFrames } = session;
    this.#measure(nowMs);
    const { renderer } = painter;
    this.isMoving = false;
    if (renderer === null || manifest === null || view.isEmpty) return false;
    this.attach(renderer);
    const { inbetween } = renderer;
    // Within a frame the share only grows: a pause shows all of the motion, and nothing jumps back after it.
    let share = shownFrame === this.#frame ? (inbetween?.share ?? 1) : 0;
    this.#frame = shownFrame;
    if (interpolates && line?.zeroMs != null) {
      this.isMoving = 1000 > FASTER * manifest.fps * line.rate * this.#screenMs;
      this.#isRequested = this.isMoving || this.#intervals.length < LEAST_INTERVALS;
      const nowFrom1970Ms = performance.timeOrigin + nowMs;
      const way = shareAt(nowFrom1970Ms, line, shownFrame, manifest.fps, numFrames);
      share = Math.max(share, way);
    }
    if (!this.isMoving) share = 1;
    if (inbetween && inbetween.share !== share) {
      inbetween.share = share;
      view.needsDrawing ||= inbetween.isMoving;
    }
    if (this.#isRequested && view.headset === null) view.loop.request();
    return this.isMoving;
  }

  /** Measures the screen's rate from consecutive pictures. @param {number} nowMs */
  #measure(nowMs) {
    if (this.#isRequested) {
      this.#intervals.push(nowMs - this.#lastMs);
      this.#measuredMs = nowMs;
    }
    this.#isRequested = false;
    this.#lastMs = nowMs;
    if (this.#intervals.length > MOST_INTERVALS) this.#intervals.shift();
    if (nowMs - this.#measuredMs > AGAIN_MS) this.#intervals = [];
    if (this.#intervals.length < LEAST_INTERVALS) return;
    const sorted = [...this.#intervals].sort((a, b) => a - b);
    this.#screenMs = sorted[sorted.length >> 1];
  }
}
