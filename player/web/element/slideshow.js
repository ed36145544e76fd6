import { prefersStill } from "./motion.js";
import { node } from "./nodes.js";
import { Storyboard } from "./storyboard.js";

const SLIDE_MS = 1000;

/** The pictures of a stream's storyboard one after the other, where the stream itself cannot be drawn. */
export class SlideShow {
  #storyboard = new Storyboard();
  #timer = 0;
  #frame = 0;

  /** @param {import("./webplayer.js").WebPlayer} player one whose stream has a storyboard */
  constructor(player) {
    this.player = player;
    this.root = node("div", { class: "slides", "aria-hidden": "true" }, this.#storyboard.root);
    this.#show();
    if (!prefersStill()) this.#timer = setInterval(() => this.#next(), SLIDE_MS);
  }

  #next() {
    const { player } = this;
    const { stepFrames } = this.#storyboard.layout ?? { stepFrames: 1 };
    const next = this.#frame + stepFrames;
    this.#frame = next < player.numFrames ? next : 0;
    this.#show();
  }

  #show() {
    this.#storyboard.show(this.player, this.#frame);
  }

  close() {
    clearInterval(this.#timer);
    this.root.remove();
  }
}
