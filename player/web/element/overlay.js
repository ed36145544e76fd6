import { icon } from "./icons.js";
import { node } from "./nodes.js";

/**
 * State of the player, which decides what the overlay shows.
 * @typedef {"failed" | "loading" | "start" | "playing" | "waiting" | "paused" | "ended"} Condition
 */

/** Everything over the picture except the bar: poster, spinner and the large button. */
export class Overlay {
  /** @type {Condition} */
  condition = "loading";

  /** @param {() => void} play */
  constructor(play) {
    this.poster = node("img", { class: "poster", alt: "", hidden: true });
    // The poster that a stream names may be missing.
    this.poster.addEventListener("error", () => (this.poster.hidden = true));
    const ring = node("span", { class: "ring" });
    const label = node("span", { class: "label" }, "Loading");
    this.spinner = node("div", { class: "spinner", role: "status" }, ring, label);
    this.large = node("button", { class: "large", hidden: true });
    this.large.addEventListener("click", play);
    this.parts = [this.poster, this.spinner, this.large];
  }

  /** @param {string | null} url of the poster; null: none */
  setPoster(url) {
    this.poster.hidden = !url;
    if (url) this.poster.src = url;
  }

  get hasPoster() {
    return !this.poster.hidden;
  }

  /**
   * @param {Condition} condition
   * @param {boolean} isShown whether the canvas shows a frame
   * @param {boolean} isWaiting for data
   */
  show(condition, isShown, isWaiting) {
    this.poster.classList.toggle("gone", isShown);
    const isLarge = condition === "start" || condition === "ended";
    const spins = condition === "loading" || (condition !== "failed" && isWaiting && !isLarge);
    this.spinner.hidden = !spins;
    if (condition === this.condition) return;
    this.condition = condition;
    this.large.hidden = !isLarge;
    if (!isLarge) return;
    const [name, label] =
      condition === "start"
        ? [/** @type {const} */ ("play"), "Play"]
        : [/** @type {const} */ ("replay"), "Play again"];
    this.large.replaceChildren(icon(name));
    this.large.setAttribute("aria-label", label);
  }
}
