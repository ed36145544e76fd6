import { node } from "./nodes.js";

const SHORT_MS = 2000;

/** One line over the picture: a brief message, or otherwise the first active condition. */
export class Hints {
  #timer = 0;
  #brief = "";
  /** @type {Map<string, string>} */
  #conditions = new Map();
  /** @type {import("./texts.js").Translate} */
  #t = String;

  constructor() {
    this.root = node("div", { class: "note soft", role: "status" });
  }

  /** @param {import("./texts.js").Translate} t */
  translate(t) {
    this.#t = t;
    this.#show();
  }

  /**
   * @param {string} message
   * @param {number} [forMs]
   */
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
   * @param {string} name
   * @param {string} message
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
