/** The storyboard: small pictures of a finished stream, in one file (FORMAT.md, section 4). */

import { MAX_STORYBOARD_TILES, STORYBOARD_COLUMNS, STORYBOARD_PER_S } from "../constants.js";
import { node, prefersStill } from "../element/nodes.js";
import { pictureUrl } from "../source/addresses.js";

/**
 * @typedef {object} StoryboardLayout
 * @property {number} stepFrames from one tile to the next
 * @property {number} numTiles @property {number} columns @property {number} rows
 */

/**
 * The arrangement of the tiles in a stream's storyboard.
 * @param {number} numFrames @param {number} fps @returns {StoryboardLayout}
 */
export function storyboardLayout(numFrames, fps) {
  const stepFrames = Math.max(
    Math.ceil(fps / STORYBOARD_PER_S),
    Math.ceil(numFrames / MAX_STORYBOARD_TILES),
  );
  const numTiles = Math.ceil(numFrames / stepFrames);
  const columns = Math.min(STORYBOARD_COLUMNS, numTiles);
  return { stepFrames, numTiles, columns, rows: Math.ceil(numTiles / columns) };
}

/**
 * The tile that shows `frame`, or the nearest frame before it.
 * @param {StoryboardLayout} layout @param {number} frame
 */
function tileOf({ stepFrames, numTiles }, frame) {
  return Math.max(0, Math.min(numTiles - 1, Math.floor(frame / stepFrames)));
}

/** The preview picture of a frame, from the stream's storyboard; hidden for streams without one. */
export class Storyboard {
  root = node("div", { class: "tile", hidden: true });
  image = new Image();
  frame = 0;
  /** @type {StoryboardLayout | null} */
  layout = null;

  constructor() {
    this.image.addEventListener("load", () => this.#show());
  }

  /** Forgets the storyboard, because the stream was changed or closed. */
  clear() {
    this.layout = null;
    this.root.hidden = true;
    this.image.removeAttribute("src");
  }

  /**
   * Shows the picture of `frame` as soon as the storyboard has arrived; the first call fetches it. A live
   * stream has no storyboard yet.
   * @param {import("../element/webplayer.js").WebPlayer} player @param {number} frame
   */
  show(player, frame) {
    const { manifest, live, numFrames } = player;
    this.frame = frame;
    if (!manifest?.storyboard || live) return;
    if (this.layout === null) {
      const layout = (this.layout = storyboardLayout(numFrames, manifest.fps));
      pictureUrl(player, manifest.storyboard).then(
        (url) => {
          if (url !== null && this.layout === layout) this.image.src = url;
        },
        (error) => console.warn("swings: the pictures over the scrub bar are missing:", error),
      );
    }
    this.#show();
  }

  #show() {
    const { layout, image, root, frame } = this;
    if (layout === null || !image.complete || image.naturalWidth === 0) return;
    const { columns, rows } = layout;
    const tile = tileOf(layout, frame);
    const share = (/** @type {number} */ at, /** @type {number} */ count) =>
      `${count > 1 ? (100 * at) / (count - 1) : 0}%`;
    const { style } = root;
    style.backgroundImage = `url("${image.src}")`;
    style.backgroundSize = `${100 * columns}% ${100 * rows}%`;
    style.backgroundPosition = `${share(tile % columns, columns)} ${share(Math.floor(tile / columns), rows)}`;
    const aspect = (image.naturalWidth * rows) / (image.naturalHeight * columns);
    style.aspectRatio = `${aspect}`;
    style.setProperty("--aspect", `${aspect}`);
    root.hidden = false;
  }
}

const SLIDE_MS = 1000;

/** The pictures of a stream's storyboard one after the other, where the stream itself cannot be drawn. */
export class SlideShow {
  #storyboard = new Storyboard();
  #timer = 0;
  #frame = 0;
  root = node("div", { class: "slides", "aria-hidden": "true" }, this.#storyboard.root);

  /** @param {import("../element/webplayer.js").WebPlayer} player one whose stream has a storyboard */
  constructor(player) {
    this.player = player;
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
