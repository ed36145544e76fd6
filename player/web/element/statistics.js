import { node } from "./nodes.js";
import { scenePointAt } from "./pointing.js";

const PERIOD_MS = 250;

/** A panel of numbers about the play. */
export class Statistics {
  #timer = 0;
  /** Where the pointer is over the picture, CSS pixels. @type {[number, number] | null} */
  #pointer = null;

  /** @param {import("./webplayer.js").WebPlayer} player */
  constructor(player) {
    this.player = player;
    this.root = node("pre", { class: "stats", hidden: true });
    player.canvas.addEventListener("pointermove", ({ offsetX, offsetY }) => {
      this.#pointer = [offsetX, offsetY];
    });
    player.canvas.addEventListener("pointerleave", () => (this.#pointer = null));
  }

  get isOn() {
    return !this.root.hidden;
  }

  toggle() {
    this.root.hidden = !this.root.hidden;
    clearInterval(this.#timer);
    if (!this.isOn) return;
    const write = () => (this.root.textContent = this.#text());
    write();
    this.#timer = setInterval(write, PERIOD_MS);
  }

  close() {
    clearInterval(this.#timer);
  }

  #text() {
    const { player } = this;
    if (player.manifest === null) return "";
    const { state, timings, manifest, renderer } = player;
    const ms = (/** @type {number} */ value) => `${value.toFixed(1)} ms`;
    const buffered = (state.endFrame - state.frame) / manifest.fps;
    const rate =
      state.rateBps === null ? "rate not known yet" : `${(state.rateBps / 1e6).toFixed(1)} Mbit/s`;
    const point = this.#pointer && scenePointAt(player.view, ...this.#pointer);
    return [
      `frame     ${state.frame} of ${player.numFrames}, ${manifest.fps} per second`,
      `pictures  ${timings.framesPerS.toFixed(0)} per second`,
      `buffer    ${buffered.toFixed(1)} s, ${state.stalls} stalls`,
      `link      ${rate}, ${(state.receivedBytes / 1e6).toFixed(1)} MB so far`,
      `Gaussians ${renderer?.numDrawn ?? 0} drawn, ${manifest.numGs} slots`,
      `layers    ${state.layers} of ${manifest.numLayers}`,
      `decode    ${ms(state.decodeMs)}`,
      `sort      ${ms(timings.sortMs)}`,
      `upload    ${ms(timings.uploadMs)}, ${((renderer?.uploadedBytes ?? 0) / 1e6).toFixed(1)} MB so far`,
      `draw      ${ms(timings.drawMs)}`,
      `pointer   ${point?.map((metres) => metres.toFixed(3)).join(" ") ?? "-"}`,
    ].join("\n");
  }
}
