import { drawn, icon } from "./icons.js";
import { node } from "./nodes.js";

/**
 * Icons of the entries that exist only in the menu, by entry name.
 * @type {Record<string, string>}
 */
const ICONS = {
  back: "M15 5l1.5 1.5L11 12l5.5 5.5L15 19l-7-7z",
  rate: "M12 5a9 9 0 0 0-9 9c0 1.8.5 3.5 1.5 5h15A9 9 0 0 0 12 5zm0 11a2 2 0 0 1-1-3.7l5-3.3-2.3 5.5A2 2 0 0 1 12 16z",
  quality: "M12 3l9 5-9 5-9-5zM5.5 11.5L12 15l6.5-3.5L21 13l-9 5-9-5z",
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
 * @property {string} name
 * @property {string} label
 * @property {() => { value: number, label: string }[]} values
 * @property {() => number} now
 * @property {(value: number) => void} choose
 */

/**
 * The menu for everything that has no room in the bar, built as in
 * https://www.w3.org/WAI/ARIA/apg/patterns/menu-button/. A choice replaces the menu by a page of its own.
 */
export class Menu {
  /**
   * @param {HTMLElement} button
   * @param {Choice[]} choices
   * @param {Command[]} commands
   * @param {() => void} changed called when the menu was opened or closed
   */
  constructor(button, choices, commands, changed) {
    this.button = button;
    this.choices = choices;
    this.commands = commands;
    this.changed = changed;
    this.root = node("div", { class: "menu", role: "menu", "aria-label": "More", hidden: true });
    this.root.addEventListener("keydown", (event) => this.#pressed(event));
  }

  get isOpen() {
    return !this.root.hidden;
  }

  toggle() {
    if (this.isOpen) this.close();
    else this.open(0);
  }

  /** @param {number} at index of the entry that gets the focus; -1: the last one */
  open(at) {
    this.#showAll();
    this.root.hidden = false;
    this.button.setAttribute("aria-expanded", "true");
    this.changed();
    this.#entries.at(at)?.focus();
  }

  /** @param {boolean} [toButton] whether the focus goes back to the menu's button */
  close(toButton = true) {
    if (!this.isOpen) return;
    this.root.hidden = true;
    this.button.setAttribute("aria-expanded", "false");
    if (toButton) this.button.focus();
    this.changed();
  }

  /** The visible entries, in order. */
  get #entries() {
    const all = /** @type {HTMLElement[]} */ ([...this.root.querySelectorAll("button")]);
    return all.filter((entry) => entry.checkVisibility());
  }

  #showAll() {
    const choices = this.choices.map((choice) => {
      const { value, label } = this.#current(choice);
      const entry = this.#entry(
        { role: "menuitem", class: "narrow", "aria-haspopup": "menu", "data-name": choice.name },
        [
          drawn(ICONS[choice.name]),
          node("span", {}, choice.label),
          node("span", { class: "value" }, label),
        ],
        () => this.#showChoice(choice, value),
      );
      return entry;
    });
    const commands = this.commands
      .filter(({ place }) => place !== "bar")
      .map(({ name, label, icon: iconName, key, place, run, isOn }) => {
        const isOnNow = isOn?.();
        const attributes = {
          role: isOn ? "menuitemcheckbox" : "menuitem",
          "aria-checked": isOnNow === undefined ? null : String(isOnNow),
          "data-name": name,
          class: place === "wide" ? "narrow" : null,
        };
        const cap = key && node("kbd", {}, key.toUpperCase());
        const shown = iconName ? icon(iconName) : drawn(ICONS[name]);
        return this.#entry(attributes, [shown, node("span", {}, label), cap], () => {
          this.close();
          run();
        });
      });
    this.root.replaceChildren(...choices, ...commands);
  }

  /** @param {Choice} choice */
  #current({ values, now }) {
    const at = now();
    return values().find(({ value }) => value === at) ?? { value: at, label: String(at) };
  }

  /**
   * @param {Choice} choice
   * @param {number} now
   */
  #showChoice({ name, label, values, choose }, now) {
    const back = () => {
      this.#showAll();
      /** @type {HTMLElement | null} */ (this.root.querySelector(`[data-name="${name}"]`))?.focus();
    };
    const attributes = { role: "menuitem", class: "back", "aria-label": `Back from ${label}` };
    const header = this.#entry(attributes, [drawn(ICONS.back), node("span", {}, label)], back);
    const entries = values().map(({ value, label: text }) => {
      const isNow = value === now;
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
   * @param {Record<string, string | null>} attributes
   * @param {(Node | string)[]} children
   * @param {() => void} action
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
