import { drawn, node } from "../element/nodes.js";
import { icon, valueOf } from "./bar.js";

/** Icons of the entries that exist only in the menu, by entry name. @type {Record<string, string>} */
const ICONS = {
  back: "M15 5l1.5 1.5L11 12l5.5 5.5L15 19l-7-7z",
  rate: "M12 5a9 9 0 0 0-9 9c0 1.8.5 3.5 1.5 5h15A9 9 0 0 0 12 5zm0 11a2 2 0 0 1-1-3.7l5-3.3-2.3 5.5A2 2 0 0 1 12 16z",
  quality: "M12 3l9 5-9 5-9-5zM5.5 11.5L12 15l6.5-3.5L21 13l-9 5-9-5z",
  captions:
    "M4 5h16a1 1 0 0 1 1 1v12a1 1 0 0 1-1 1H4a1 1 0 0 1-1-1V6a1 1 0 0 1 1-1zm6.5 5.5a3 3 0 1 0 0 3l-1.3-.8a1.5 1.5 0 1 1 0-1.4zm7 0a3 3 0 1 0 0 3l-1.3-.8a1.5 1.5 0 1 1 0-1.4z",
  views: "M4 7h10a1 1 0 0 1 1 1v2.5l5-3v9l-5-3V16a1 1 0 0 1-1 1H4a1 1 0 0 1-1-1V8a1 1 0 0 1 1-1z",
  mute: "M3 9v6h4l5 5V4L7 9zM14 7.5v9a5 5 0 0 0 0-9z",
  loop: "M7 7h10v3l4-4-4-4v3H5v6h2zm10 10H7v-3l-4 4 4 4v-3h12v-6h-2z",
  "side-by-side": "M3 6h8v12H3zm2 2v8h4V8zm8-2h8v12h-8zm2 2v8h4V8z",
  fly: "M21 3L3 10.5l6.5 3L12.5 21zM9.6 11.6l6.2-3.4-5 5z",
  pip: "M3 5h18v14H3zm2 2v10h14V7zm6 4h7v5h-7z",
  save: "M4 4h16v16H4zm2 2v9l3.5-4 3 3.5 2-2L18 16V6zm8.5 1.5a1.8 1.8 0 1 1 0 3.6 1.8 1.8 0 0 1 0-3.6z",
  download: "M11 4h2v8h3.5L12 17l-4.5-5H11zM4 18h16v2H4z",
  "save-frame":
    "M7 4a3 3 0 1 1 0 6 3 3 0 0 1 0-6zm10 1a4 4 0 1 1 0 8 4 4 0 0 1 0-8zM9 13a4 4 0 1 1 0 8 4 4 0 0 1 0-8zm8 3a2 2 0 1 1 0 4 2 2 0 0 1 0-4z",
  embed: "M9 7l-5 5 5 5-1.5 1.5L1 12l6.5-6.5zm6 0l5 5-5 5 1.5 1.5L23 12l-6.5-6.5z",
  gyroscope: "M7 2h10v20H7zm2 3v13h6V5zM2 9l3-3v2.5h1v1H5V12zm20 6l-3 3v-2.5h-1v-1h1V12z",
  interpolate: "M3 8h4v8H3zm7 0h1v8h-1zm3 0h1v8h-1zm4 0h4v8h-4z",
  statistics: "M4 19h16v2H4zM6 11h3v7H6zm5-6h3v13h-3zm5 9h3v4h-3z",
  keys: "M3 6h18v12H3zm2 2v2h2V8zm3.5 0v2h2V8zm3.5 0v2h2V8zm3.5 0v2h2V8zM5 11.5v2h2v-2zm3.5 0v2h2v-2zm3.5 0v2h2v-2zm3.5 0v2h2v-2zM8 15v1.5h8V15z",
};

/** @typedef {import("./commands.js").Command} Command */

/**
 * A setting with a fixed list of values, such as the speed.
 * @typedef {object} Choice
 * @property {string} name @property {string} label
 * @property {boolean} [isInBar] whether it has a button in the bar while there is room
 * @property {() => boolean} isThere whether this stream has it
 * @property {() => { value: number, label: string }[]} values
 * @property {() => number} now @property {(value: number) => void} choose
 */

/**
 * The menu for everything that has no room in the bar, built as in
 * https://www.w3.org/WAI/ARIA/apg/patterns/menu-button/. A choice replaces the menu by a page of its own,
 * which its button in the bar opens as well.
 */
export class Menu {
  /**
   * @param {import("./bar.js").Bar} bar @param {Choice[]} choices @param {Command[]} commands
   * @param {import("./texts.js").Translate} t @param {() => void} changed called when the menu was opened or closed
   */
  constructor(bar, choices, commands, t, changed) {
    this.t = t;
    this.bar = bar;
    /** The button that has opened the menu, to which the focus returns. @type {HTMLElement} */
    this.opener = bar.menuButton;
    /** @type {Choice[]} */ this.choices = choices;
    /** @type {Command[]} */ this.commands = commands;
    /** @type {() => void} */ this.changed = changed;
    const attributes = { class: "menu", role: "menu", "aria-label": t("More"), hidden: true };
    /** @type {HTMLDivElement} */ this.root = node("div", attributes);
    this.root.addEventListener("keydown", (event) => this.#pressed(event));
  }

  get isOpen() {
    return !this.root.hidden;
  }

  /**
   * @param {HTMLElement} opener
   * @param {number | Choice | null} at index of the entry that gets the focus (-1: the last one), or a choice
   *   whose values to show; null closes an open menu, and opens it at the first entry
   */
  openFor(opener, at) {
    const isSame = this.isOpen && opener === this.opener;
    this.close(false);
    if (isSame && typeof at !== "number") return opener.focus();
    this.opener = opener;
    if (at === null || typeof at === "number") this.#showAll();
    this.root.hidden = false;
    opener.setAttribute("aria-expanded", "true");
    this.changed();
    if (at === null || typeof at === "number") this.#entries.at(at ?? 0)?.focus();
    else this.#showChoice(at);
  }

  /** @param {boolean} [toOpener] whether the focus goes back to the button that opened the menu */
  close(toOpener = true) {
    if (!this.isOpen) return;
    this.root.hidden = true;
    this.opener.setAttribute("aria-expanded", "false");
    if (toOpener) this.opener.focus();
    this.changed();
  }

  /** The entries, in order. */
  get #entries() {
    return /** @type {HTMLElement[]} */ ([...this.root.querySelectorAll("button")]);
  }

  #showAll() {
    const isMissing = (/** @type {string} */ name) => !this.bar.shows(name);
    const choices = this.choices
      .filter(({ name, isThere }) => isThere() && isMissing(name))
      .map((choice) => {
        const { name, label } = choice;
        const value = node("span", { class: "value" }, valueOf(choice).label);
        return this.#entry(
          { role: "menuitem", "aria-haspopup": "menu", "data-name": name },
          [drawn(ICONS[name]), node("span", {}, label), value],
          () => this.#showChoice(choice),
        );
      });
    const commands = this.commands
      .filter(({ name, isThere }) => (isThere?.() ?? true) && isMissing(name))
      .map(({ name, label, icon: iconName, key, run, isOn }) => {
        const isOnNow = isOn?.();
        const attributes = {
          role: isOn ? "menuitemcheckbox" : "menuitem",
          "aria-checked": isOnNow === undefined ? null : String(isOnNow),
          "data-name": name,
        };
        const cap = key && node("kbd", {}, key.toUpperCase());
        const shown = iconName ? icon(iconName) : drawn(ICONS[name]);
        return this.#entry(attributes, [shown, node("span", {}, this.t(label)), cap], () => {
          this.close();
          run();
        });
      });
    this.root.replaceChildren(...choices, ...commands);
  }

  /** @param {Choice} choice */
  #showChoice({ name, label, values, now, choose }) {
    const back = () => {
      if (this.opener !== this.bar.menuButton) return this.close();
      this.#showAll();
      /** @type {HTMLElement | null} */ (this.root.querySelector(`[data-name="${name}"]`))?.focus();
    };
    const backLabel = this.t("Back from {choice}", { choice: label });
    const attributes = { role: "menuitem", class: "back", "aria-label": backLabel };
    const header = this.#entry(attributes, [drawn(ICONS.back), node("span", {}, label)], back);
    const at = now();
    const entries = values().map(({ value, label: text }) => {
      const isNow = value === at;
      const radio = { role: "menuitemradio", "aria-checked": String(isNow) };
      return this.#entry(radio, [node("span", {}, text)], () => {
        choose(value);
        this.close();
      });
    });
    this.root.replaceChildren(header, ...entries);
    (entries.find((entry) => entry.getAttribute("aria-checked") === "true") ?? header).focus();
  }

  /**
   * @param {Record<string, string | null>} attributes @param {(Node | string)[]} children @param {() => void} action
   */
  #entry(attributes, children, action) {
    const entry = node("button", { ...attributes, tabindex: "-1" }, ...children);
    entry.addEventListener("click", action);
    return entry;
  }

  /** @param {KeyboardEvent} event */
  #pressed(event) {
    const entries = this.#entries;
    const at = entries.findIndex((entry) => entry === event.target);
    const back = this.root.querySelector(".back");
    const goBack = () => (back instanceof HTMLElement ? back.click() : this.close());
    /** @type {Record<string, () => void>} */
    const actions = {
      ArrowDown: () => entries[(at + 1) % entries.length]?.focus(),
      ArrowUp: () => entries.at(at - 1)?.focus(),
      Home: () => entries[0]?.focus(),
      End: () => entries.at(-1)?.focus(),
      ArrowLeft: goBack,
      ArrowRight: () => entries[at]?.ariaHasPopup === "menu" && entries[at].click(),
      Escape: goBack,
      Tab: () => this.close(),
    };
    const action = actions[event.key];
    if (action === undefined) return;
    if (event.key !== "Tab") event.preventDefault();
    event.stopPropagation();
    action();
  }
}
