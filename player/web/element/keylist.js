import { node } from "./nodes.js";

const ARROWS = {
  arrowleft: "←",
  arrowright: "→",
  arrowup: "↑",
  arrowdown: "↓",
};

/** The dialog that lists the keys. */
export class KeyList {
  /**
   * @param {import("./keys.js").KeyAction[]} actions read whenever the list opens
   * @param {import("./texts.js").Translate} t
   */
  constructor(actions, t) {
    this.actions = actions;
    this.t = t;
    this.list = node("dl");
    const close = node("button", { class: "close" }, t("Close"));
    close.addEventListener("click", () => this.root.close());
    const attributes = { class: "keylist", "aria-labelledby": "keys" };
    const header = node("header", {}, node("h2", { id: "keys" }, t("Keys")), close);
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
    const { t } = this;
    /** @type {Record<string, string>} */
    const names = { ...ARROWS, " ": t("Space"), home: t("Home"), end: t("End") };
    const nameOf = (/** @type {string} */ key) =>
      names[key] ?? key.toUpperCase().replace("SHIFT+", "⇧");
    const rows = this.actions.map(({ keys, label }) => {
      const caps = keys.length > 4 ? [`${keys[0]} – ${keys[keys.length - 1]}`] : keys.map(nameOf);
      const shown = caps.map((key) => node("kbd", {}, key));
      return node("div", {}, node("dt", {}, ...shown), node("dd", {}, t(label)));
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
