/** The track of the bar, the time as a text, and the badge of a live stream. */

import { node } from "../element/nodes.js";
import { isBehind } from "../source/liveedge.js";
import { Storyboard } from "./storyboard.js";

/** A clip shorter than this shows tenths of seconds, because whole seconds hardly move. */
const SHORT_S = 10;

/** A duration as text: 1:07, 1:00:07, or 0:07.3 with tenths. @param {number} seconds @param {boolean} [hasTenths] */
export function timeText(seconds, hasTenths = false) {
  // Rounding may put a frame's time just below its tenth.
  const tenths = Math.max(0, Math.floor(seconds * 10 + 1e-6));
  const whole = Math.floor(tenths / 10);
  const minutes = Math.floor(whole / 60) % 60;
  const hours = Math.floor(whole / 3600);
  const pad = (/** @type {number} */ n) => String(n).padStart(2, "0");
  const rest = `${hours ? pad(minutes) : minutes}:${pad(whole % 60)}`;
  return `${hours ? `${hours}:` : ""}${rest}${hasTenths ? `.${tenths % 10}` : ""}`;
}

/**
 * The time of a frame: since the first frame, or behind the edge of a live stream.
 * @param {number} frame @param {number} numFrames @param {number} fps @param {boolean} live
 */
export function frameTimeText(frame, numFrames, fps, live) {
  if (live) return `-${timeText((numFrames - 1 - frame) / fps)}`;
  return timeText(frame / fps, isShort(numFrames, fps));
}

/**
 * The time of a frame, and the stream's length. The last frame counts as the end.
 * @param {number} frame @param {number} numFrames @param {number} fps @param {boolean} live
 */
export function positionText(frame, numFrames, fps, live) {
  if (live) return frameTimeText(frame, numFrames, fps, live);
  const isLast = frame > 0 && frame === numFrames - 1;
  const now = frameTimeText(isLast ? numFrames : frame, numFrames, fps, live);
  return `${now} / ${timeText(numFrames / fps, isShort(numFrames, fps))}`;
}

/** @param {number} numFrames @param {number} fps */
function isShort(numFrames, fps) {
  return numFrames > 0 && numFrames / fps < SHORT_S;
}

const THUMB_PX = 14;

/**
 * The scrub bar: it shows the current frame, the loaded ranges, and above the pointer the time and a
 * small picture. While the thumb moves, the player shows an approximation of the frame there; it seeks
 * the frame when the thumb is released.
 */
export class Scrubber {
  #scrubbing = false;
  #request = 0;
  #track = "";
  /** @type {Storyboard | null} null until the first stream that has one */
  #storyboard = null;
  /** The frame that the preview shows. */
  #previewed = 0;
  hoverTime = node("span", { class: "hover-time" });
  preview = node("div", { class: "preview", "aria-hidden": "true", hidden: true }, this.hoverTime);
  time = node("span", { class: "time" }, "0:00 / 0:00");

  /**
   * @param {import("../element/webplayer.js").WebPlayer} player @param {import("./texts.js").Translate} t
   * @param {AbortSignal} signal ends the listening
   */
  constructor(player, t, signal) {
    this.player = player;
    this.t = t;
    const attributes = {
      class: "scrub slider",
      type: "range",
      min: "0",
      max: "0",
      step: "1",
      value: "0",
    };
    this.input = node("input", { ...attributes, "aria-label": t("Seek") });
    this.root = node("div", { class: "scrubber" }, this.preview, this.input);
    this.input.addEventListener("input", () => this.#scrub());
    this.input.addEventListener("change", () => {
      cancelAnimationFrame(this.#request);
      this.#request = 0;
      this.#scrubbing = false;
      this.preview.hidden = true;
      player.seek(Number(this.input.value));
    });
    this.input.addEventListener("pointermove", (event) => {
      if (event.pointerType === "mouse") this.#hover(event.offsetX);
    });
    this.input.addEventListener("pointerleave", () => (this.preview.hidden = !this.#scrubbing));
    const fit = () => (this.input.max = String(Math.max(0, player.numFrames - 1)));
    fit(); // the stream may be open already
    for (const type of ["opened", "grown"]) player.addEventListener(type, fit, { signal });
    player.addEventListener("opened", () => this.#storyboard?.clear(), { signal });
  }

  get isScrubbing() {
    return this.#scrubbing;
  }

  #scrub() {
    const { input, player } = this;
    this.#scrubbing = true;
    const frame = Number(input.value);
    this.#showTime(frame);
    this.#showTrack();
    this.#showPreview(frame);
    if (this.#request !== 0) return;
    this.#request = requestAnimationFrame(() => {
      this.#request = 0;
      player.scrub(Number(input.value));
    });
  }

  /** @param {number} atPx from the bar's left side */
  #hover(atPx) {
    const { player } = this;
    if (this.#scrubbing || !player.manifest) return;
    const last = player.numFrames - 1;
    // The middle of the thumb stays within the bar by half its width.
    const share = (atPx - THUMB_PX / 2) / (this.input.clientWidth - THUMB_PX);
    this.#showPreview(Math.max(0, Math.min(last, Math.round(share * last))));
  }

  /** @param {number} frame */
  #showPreview(frame) {
    const { player, preview, hoverTime } = this;
    const { fps } = player.manifest ?? { fps: 30 };
    hoverTime.textContent = frameTimeText(frame, player.numFrames, fps, player.live);
    this.#previewed = frame;
    this.#showPicture();
    preview.hidden = false;
    const widthPx = this.root.clientWidth;
    const halfPx = preview.offsetWidth / 2;
    const share = frame / Math.max(1, player.numFrames - 1);
    const atPx = THUMB_PX / 2 + (widthPx - THUMB_PX) * share;
    preview.style.left = `${Math.max(halfPx, Math.min(widthPx - halfPx, atPx))}px`;
  }

  #showPicture() {
    const { player, preview } = this;
    if (!player.manifest?.storyboard) return;
    if (this.#storyboard === null) {
      this.#storyboard = new Storyboard();
      preview.prepend(this.#storyboard.root);
    }
    this.#storyboard.show(player, this.#previewed);
  }

  /** Moves the thumb to the current frame, unless the user is dragging it. */
  show() {
    const { state } = this.player;
    if (!this.#scrubbing) {
      this.input.value = String(state.frame);
      this.#showTime(state.frame);
    }
    this.#showTrack();
  }

  /** @param {number} frame */
  #showTime(frame) {
    const { player, time, input } = this;
    const { manifest, numFrames, live } = player;
    const isAtEdge = live && manifest !== null && !isBehind(manifest, numFrames, frame);
    const text = isAtEdge ? "" : positionText(frame, numFrames, manifest?.fps ?? 30, live);
    if (time.textContent === text) return; // setting the same text again would cost a layout
    time.textContent = text;
    input.setAttribute("aria-valuetext", text || this.t("LIVE"));
  }

  /** Colours the track: the part before the thumb, the loaded ranges, and the rest. */
  #showTrack() {
    const { player, input } = this;
    const { state, numFrames } = player;
    const share = (/** @type {number} */ frame) =>
      `${((100 * Math.max(0, Math.min(frame, numFrames - 1))) / Math.max(1, numFrames - 1)).toFixed(2)}%`;
    const frame = Number(input.value);
    const stops = [`var(--played) ${share(frame)}`];
    let at = frame;
    for (const [first, end] of state.bufferedRanges) {
      if (end - 1 <= at) continue;
      const begin = Math.max(first, at);
      stops.push(`var(--rest) ${share(at)} ${share(begin)}`);
      stops.push(`var(--loaded) ${share(begin)} ${share(end - 1)}`);
      at = end - 1;
    }
    stops.push(`var(--rest) ${share(at)}`);
    const track = `linear-gradient(to right, ${stops.join(", ")})`;
    if (this.#track === track) return;
    this.#track = track;
    input.style.setProperty("--track", track);
  }

  close() {
    cancelAnimationFrame(this.#request);
  }
}

/** A live stream counts as stopped if it has not grown for this many times the length of a segment, */
const STOPPED_SEGMENTS = 5;
/** but not before this time. */
const LEAST_STOPPED_S = 10;

/** @param {{ fps: number, segmentFrames: number }} manifest */
function stoppedAfterS({ fps, segmentFrames }) {
  return Math.max(LEAST_STOPPED_S, (STOPPED_SEGMENTS * segmentFrames) / fps);
}

/**
 * The LIVE badge: visible while a stream is live, grey if the picture is behind the live edge or the
 * stream's writer has stopped.
 */
export class LiveBadge {
  #timer = 0;
  hasStopped = false;

  /**
   * @param {import("../element/webplayer.js").WebPlayer} player
   * @param {(hasStopped: boolean) => void} onStopped @param {import("./texts.js").Translate} t
   * @param {AbortSignal} signal ends the listening
   */
  constructor(player, onStopped, t, signal) {
    const label = t("Go to the live edge");
    const attributes = {
      class: "badge",
      "aria-label": label,
      title: `${label} (${t("End")})`,
      hidden: true,
    };
    this.root = node("button", attributes, node("span", {}, t("LIVE")));
    this.player = player;
    this.onStopped = onStopped;
    const watch = () => {
      clearTimeout(this.#timer);
      this.#setStopped(false);
      const { live, manifest } = player;
      if (!live || manifest === null) return;
      const waitMs = 1000 * stoppedAfterS(manifest);
      this.#timer = setTimeout(() => this.#setStopped(true), waitMs);
    };
    for (const type of ["opened", "grown"]) player.addEventListener(type, watch, { signal });
    for (const type of ["opened", "state", "grown"])
      player.addEventListener(type, () => this.#show(), { signal });
    signal.addEventListener("abort", () => clearTimeout(this.#timer));
    watch(); // the stream may be open already
    this.#show();
  }

  /** @param {boolean} hasStopped */
  #setStopped(hasStopped) {
    if (hasStopped === this.hasStopped) return;
    this.hasStopped = hasStopped;
    this.onStopped(hasStopped);
    this.#show();
  }

  #show() {
    const { live, manifest, numFrames, state } = this.player;
    if (this.root.hidden === live) this.root.hidden = !live;
    const isBack = live && manifest !== null && isBehind(manifest, numFrames, state.frame);
    const isGrey = this.hasStopped || isBack;
    this.root.classList.toggle("behind", isGrey);
  }
}
