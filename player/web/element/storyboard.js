import { node } from "./nodes.js";
import { pictureUrl } from "../source/pictures.js";
import { storyboardLayout, tileOf } from "../format/storyboard.js";

/** The preview picture of a frame, from the stream's storyboard; hidden for streams without one. */
export class Storyboard {
  constructor() {
    this.root = node("div", { class: "tile", hidden: true });
    this.image = new Image();
    this.image.addEventListener("load", () => this.#show());
    this.frame = 0;
    /** @type {import("../format/storyboard.js").StoryboardLayout | null} */
    this.layout = null;
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
   * @param {import("./webplayer.js").WebPlayer} player
   * @param {number} frame
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
