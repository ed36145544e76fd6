import { node } from "./nodes.js";

/** @type {Record<string, string>} */
const NAMES = {
  " ": "Space",
  arrowleft: "←",
  arrowright: "→",
  arrowup: "↑",
  arrowdown: "↓",
  home: "Home",
  end: "End",
};

/** The dialog that lists the keys. */
export class KeyList {
  /** @param {import("./keys.js").KeyAction[]} actions read whenever the list opens */
  constructor(actions) {
    this.actions = actions;
    this.list = node("dl");
    const close = node("button", { class: "close" }, "Close");
    close.addEventListener("click", () => this.root.close());
    const attributes = { class: "keylist", "aria-labelledby": "keys" };
    const header = node("header", {}, node("h2", { id: "keys" }, "Keys"), close);
    this.root = node("dialog", attributes, header, this.list);
    this.root.addEventListener("keydown", (event) => {
      event.stopPropagation(); // the dialog has its own keys
      if (event.key === "?") this.root.close();
    });
    // A click beside the dialog's box hits the dialog itself.
    this.root.addEventListener("click", ({ target }) => {
      if (target === this.root) this.root.close();
    });
  }

  #fill() {
    const rows = this.actions.map(({ keys, label }) => {
      const caps = keys.length > 4 ? [`${keys[0]} – ${keys[keys.length - 1]}`] : keys.map(nameOf);
      const names = caps.map((key) => node("kbd", {}, key));
      return node("div", {}, node("dt", {}, ...names), node("dd", {}, label));
    });
    this.list.replaceChildren(...rows);
  }

  toggle() {
    if (this.root.open) this.root.close();
    else {
      this.#fill();
      this.root.showModal();
    }
  }
}

/** @param {string} key */
function nameOf(key) {
  return NAMES[key] ?? key.toUpperCase().replace("SHIFT+", "⇧");
}
