import { Inbetween } from "../renderer/inbetween.js";

/** Pictures are drawn between frames where there are so many times as many (player/playout/smoothing.py). */
const FASTER = 1.05;
/** The screen's rate is the median of so many intervals, and of no fewer than LEAST of them. */
const MOST_INTERVALS = 15;
const LEAST_INTERVALS = 5;
/** It is measured again after so long: a page that was busy seems to have a slow screen. */
const AGAIN_MS = 3000;

/** @typedef {{ zeroMs: number | null, rate: number }} Line when frames are due, see StreamSession */

/**
 * How much of the way from the frame before to the one that shows is over. It begins when the frame is
 * due, so the picture is up to one frame late.
 * @param {number} nowMs of the clock from 1970 on
 * @param {Line} line
 * @param {number} frame that shows
 * @param {number} fps
 * @param {number} numFrames after which it may have begun anew
 */
export function shareAt(nowMs, { zeroMs, rate }, frame, fps, numFrames) {
  if (zeroMs === null) return 1;
  const frames = ((nowMs - zeroMs) / 1000) * fps * rate - frame;
  // The line may be that of an earlier round.
  const way = frames - numFrames * Math.floor(frames / numFrames + 0.25);
  return Math.max(0, Math.min(1, way));
}

/** Has a view show motion between frames while they pass on a screen that is faster than they are. */
export class Smoothing {
  /** Whether the next picture shows more of the way. */
  isMoving = false;
  /** @type {number[]} milliseconds between pictures that were requested one after the other */
  #intervals = [];
  /** Whether the picture that comes was requested by the last one. */
  #isRequested = false;
  #lastMs = 0;
  #measuredMs = -Infinity;
  /** Milliseconds between two pictures of the screen; unknown, frames are drawn as they are. */
  #screenMs = Infinity;
  /** The frame of the last picture. */
  #frame = -1;
  /** @type {Inbetween | null} of the last renderer */
  #inbetween = null;

  /** @param {import("./sceneview.js").SceneView} view */
  constructor(view) {
    this.view = view;
  }

  /**
   * Does not wait for the device, which may take a second to make what draws between frames.
   * @param {import("../renderer/splatrenderer.js").SplatRenderer} renderer shall draw between frames
   */
  attach(renderer) {
    if (renderer.inbetween !== null) return;
    try {
      if (this.#inbetween?.renderer !== renderer) {
        this.#inbetween = new Inbetween(renderer, this.view.manifest.numGs);
      }
      this.#inbetween.attach();
    } catch {
      // A device that cannot do it shows each frame as it is; one that was lost gets another renderer.
      if (!renderer.gl.isContextLost()) this.view.smoothing = null;
    }
  }

  /**
   * Asks for this picture, and for the next one, if they show more of the way.
   * @param {number} nowMs of the picture, of the page's clock
   * @returns {boolean} whether Gaussians that fade out may show
   */
  step(nowMs) {
    const { view } = this;
    const { session, manifest, painter, shownFrame, interpolates } = view;
    const { line, numFrames } = session;
    this.#measure(nowMs);
    const { renderer } = painter;
    this.isMoving = false;
    if (renderer === null || view.isEmpty) return false;
    this.attach(renderer);
    const { inbetween } = renderer;
    // Within a frame it only grows: after a pause, which shows all of it, nothing jumps back.
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

  /** Measures the screen's rate by pictures that follow one another. @param {number} nowMs */
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
