/** What lies over the picture without a control: poster, spinner, the large button, and hints. */

import { drawn, node } from "./nodes.js";

const PLAY = "M8 5v14l11-7z";
const REPLAY = "M12 5V1L6 6l6 5V7a5.5 5.5 0 1 1-5.5 5.5h-2A7.5 7.5 0 1 0 12 5z";

/**
 * State of the player, which decides what the overlay shows.
 * @typedef {"empty" | "failed" | "still" | "loading" | "start" | "playing" | "waiting" | "paused" | "ended"} Condition
 */

/** Everything over the picture except the bar: poster, spinner and the large button. */
export class Overlay {
  /** @type {Condition} */
  condition = "empty";
  /** @type {import("../controls/texts.js").Translate} */
  #t = String;
  poster = node("img", { class: "poster", alt: "", hidden: true });
  label = node("span", { class: "label" }, "Loading");
  large = node("button", { class: "large", hidden: true });

  /** @param {() => void} play */
  constructor(play) {
    // The poster that a stream names may be missing.
    this.poster.addEventListener("error", () => (this.poster.hidden = true));
    this.poster.addEventListener("load", () => {
      const { naturalWidth, naturalHeight, style } = this.poster;
      style.setProperty("--aspect", `${naturalWidth / naturalHeight}`);
    });
    const ring = node("span", { class: "ring" });
    const parts = [ring, this.label];
    this.spinner = node("div", { class: "spinner", role: "status", hidden: true }, ...parts);
    this.large.addEventListener("click", play);
    this.parts = [this.poster, this.spinner, this.large];
  }

  /** @param {import("../controls/texts.js").Translate} t */
  translate(t) {
    this.#t = t;
    this.label.textContent = t("Loading");
    this.#name();
  }

  #name() {
    const t = this.#t;
    this.large.setAttribute("aria-label", this.condition === "ended" ? t("Play again") : t("Play"));
  }

  /** @param {string | null} url of the poster; null: none */
  setPoster(url) {
    this.poster.hidden = !url;
    if (url) this.poster.src = url;
  }

  /** Lays the poster as the first picture will lie. @param {number} share of the width, where what matters is */
  setFocus(share) {
    this.poster.style.setProperty("--focus", share.toFixed(3));
  }

  get hasPoster() {
    return !this.poster.hidden;
  }

  /**
   * @param {Condition} condition @param {boolean} isShown whether the canvas shows a frame
   * @param {boolean} isWaiting for data
   */
  show(condition, isShown, isWaiting) {
    this.poster.classList.toggle("gone", isShown);
    const isLarge = condition === "start" || condition === "ended";
    const spins =
      condition === "loading" || (!/empty|failed/.test(condition) && isWaiting && !isLarge);
    this.spinner.hidden = !spins;
    if (condition === this.condition) return;
    this.condition = condition;
    this.large.hidden = !isLarge;
    if (!isLarge) return;
    this.large.replaceChildren(drawn(condition === "start" ? PLAY : REPLAY));
    this.#name();
  }
}

const SHORT_MS = 2000;

/** One line over the picture: a brief message, or otherwise the first active condition. */
export class Hints {
  #timer = 0;
  #brief = "";
  /** @type {Map<string, string>} */
  #conditions = new Map();
  /** @type {import("../controls/texts.js").Translate} */
  #t = String;
  root = node("div", { class: "note soft", role: "status" });

  /** @param {import("../controls/texts.js").Translate} t */
  translate(t) {
    this.#t = t;
    this.#show();
  }

  /** @param {string} message @param {number} [forMs] */
  say(message, forMs = SHORT_MS) {
    this.#brief = message;
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => {
      this.#brief = "";
      this.#show();
    }, forMs);
    this.#show();
  }

  /**
   * Sets the message of a condition, which stays until it is set to "".
   * @param {string} name @param {string} message
   */
  hold(name, message) {
    if (message) this.#conditions.set(name, message);
    else this.#conditions.delete(name);
    this.#show();
  }

  clear() {
    clearTimeout(this.#timer);
    this.#brief = "";
    this.#conditions.clear();
    this.#show();
  }

  #show() {
    const [condition = ""] = this.#conditions.values();
    const text = this.#t(this.#brief || condition);
    if (this.root.textContent !== text) this.root.textContent = text;
  }
}
