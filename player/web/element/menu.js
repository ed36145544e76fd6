import { icon } from "./icons.js";
import { node } from "./nodes.js";

/** @typedef {import("./commands.js").Command} Command */

/**
 * A setting that has one of some values, such as the speed.
 * @typedef {object} Choice
 * @property {string} name
 * @property {string} label
 * @property {import("./icons.js").IconName} icon
 * @property {() => { value: number, label: string }[]} values
 * @property {() => number} now
 * @property {(value: number) => void} choose
 */

/**
 * The menu of what has no room in the bar, as https://www.w3.org/WAI/ARIA/apg/patterns/menu-button/
 * has it. A choice opens a page of its own in the place of the first one.
 */
export class Menu {
  /**
   * @param {HTMLElement} button
   * @param {Choice[]} choices
   * @param {Command[]} commands
   * @param {() => void} changed it was opened or closed
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

  /** @param {number} at which entry gets the focus; -1: the last one */
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

  /** The entries that show, from the first to the last. */
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
          icon(choice.icon),
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
        return this.#entry(attributes, [icon(iconName), node("span", {}, label), cap], () => {
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
    const header = this.#entry(attributes, [icon("back"), node("span", {}, label)], back);
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
