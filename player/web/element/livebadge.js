import { isBehind } from "../source/liveedge.js";
import { node } from "./nodes.js";

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

  /**
   * @param {import("./webplayer.js").WebPlayer} player
   * @param {(hasStopped: boolean) => void} onStopped
   * @param {import("./texts.js").Translate} t
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
    this.hasStopped = false;
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
    for (const type of ["opened", "state", "grown"]) {
      player.addEventListener(type, () => this.#show(), { signal });
    }
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
