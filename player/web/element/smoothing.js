import { Inbetween } from "../renderer/inbetween.js";

/** Pictures are drawn between frames where there are so many times as many (player/playout/smoothing.py). */
const FASTER = 1.05;
/** The screen's rate is the median of so many intervals; it is not known before there are LEAST of them. */
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
  /** @type {number[]} milliseconds between pictures that were asked for one after the other */
  #intervals = [];
  #lastMs = 0;
  #measuredMs = 0;
  /** @type {Line | null} to which these belong */
  #line = null;

  /** @param {import("./sceneview.js").SceneView} view */
  constructor(view) {
    this.view = view;
  }

  /** @param {import("../renderer/splatrenderer.js").SplatRenderer} renderer shall draw between frames */
  attach(renderer) {
    if (renderer.inbetween !== null) return;
    try {
      new Inbetween(renderer, this.view.manifest.numGs);
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
    if (this.isMoving) {
      this.#intervals.push(nowMs - this.#lastMs);
      this.#measuredMs = nowMs;
    }
    if (this.#intervals.length > MOST_INTERVALS) this.#intervals.shift();
    if (line !== this.#line || nowMs - this.#measuredMs > AGAIN_MS) this.#intervals = [];
    this.#line = line;
    this.#lastMs = nowMs;
    const { renderer } = painter;
    if (renderer === null || view.isEmpty) return false;
    this.attach(renderer);
    const isRunning = interpolates && line?.zeroMs != null;
    this.isMoving = isRunning && this.#isFast(manifest.fps * line.rate);
    const nowFrom1970Ms = performance.timeOrigin + nowMs;
    const share =
      this.isMoving && line ? shareAt(nowFrom1970Ms, line, shownFrame, manifest.fps, numFrames) : 1;
    const { inbetween } = renderer;
    if (inbetween && inbetween.share !== share) {
      inbetween.share = share;
      view.needsDrawing = true;
    }
    if (this.isMoving && view.headset === null) view.loop.request();
    return this.isMoving;
  }

  /** Whether the screen shows more pictures than there are frames, or it is not known. @param {number} framesHz */
  #isFast(framesHz) {
    const sorted = [...this.#intervals].sort((a, b) => a - b);
    const medianMs = sorted[sorted.length >> 1];
    return sorted.length < LEAST_INTERVALS || 1000 > FASTER * framesHz * medianMs;
  }
}
