import { icon } from "./icons.js";
import { node } from "./nodes.js";

/** @typedef {import("./commands.js").Command} Command */
/** @typedef {import("./menu.js").Choice} Choice */

/** Parts that leave a row without room for all, in this order; the menu has most of them then. */
const DROPPED_FIRST = "volume rate reset quality cc headset mute time share".split(" ");

/**
 * What the bar's buttons do, other than commands.
 * @typedef {object} BarActions
 * @property {() => void} togglePlaying
 * @property {() => void} toggleFullScreen
 * @property {(opener: HTMLElement, at: number | Choice | null) => void} openMenu focuses entry `at` (-1: the
 *   last one), or shows the values of a choice; null toggles the menu
 */

/** The scrub bar, and under it one row of buttons. */
export class Bar {
  /**
   * @param {import("./scrubber.js").Scrubber} scrubber
   * @param {HTMLElement} badge
   * @param {Choice[]} choices
   * @param {Command[]} commands
   * @param {import("./texts.js").Translate} t
   * @param {BarActions} actions
   */
  constructor(scrubber, badge, choices, commands, t, actions) {
    this.t = t;
    this.playButton = button("play", t("Play"), "K", actions.togglePlaying);
    this.fullButton = button("full", t("Full screen"), "F", actions.toggleFullScreen);
    this.menuButton = menuButton(t("More"), (at) => actions.openMenu(this.menuButton, at));
    this.choices = choices;
    this.commands = commands;
    /** @type {Map<string, HTMLButtonElement>} */
    this.buttons = new Map();
    for (const { name, label, icon: iconName, key, isInBar, run } of commands) {
      if (!isInBar || iconName === undefined) continue;
      const made = button(name, t(label), key.toUpperCase(), run);
      made.append(icon(iconName));
      this.buttons.set(name, made);
    }
    for (const choice of choices) {
      if (!choice.isInBar) continue;
      const made = node("button", { class: choice.name, "aria-haspopup": "menu" });
      made.setAttribute("aria-expanded", "false");
      made.addEventListener("click", () => actions.openMenu(made, choice));
      this.buttons.set(choice.name, made);
    }
    const { headset, ...others } = Object.fromEntries(this.buttons);
    headset.hidden = true;
    this.headset = headset;
    this.time = scrubber.time;
    this.row = node(
      "div",
      { class: "row" },
      this.playButton,
      scrubber.time,
      badge,
      node("span", { class: "space" }),
      ...Object.values(others),
      headset,
      this.menuButton,
      this.fullButton,
    );
    this.root = node("div", { class: "bar", part: "bar" }, scrubber.root, this.row);
  }

  /** Keeps everything in one row, whatever appears in it. @param {AbortSignal} signal ends that */
  follow(signal) {
    const fit = () => this.#fit();
    const resizing = new ResizeObserver(fit);
    for (const one of [this.row, this.time]) resizing.observe(one);
    // The time's own changes, ten a second, hardly ever change its size.
    const changing = new MutationObserver((changes) => {
      if (changes.some(({ target }) => target !== this.time)) fit();
    });
    changing.observe(this.row, { childList: true, subtree: true, attributeFilter: ["hidden"] });
    signal.addEventListener("abort", () => {
      resizing.disconnect();
      changing.disconnect();
    });
  }

  #fit() {
    const { row } = this;
    const [...parts] = row.children;
    for (const part of parts) part.classList.remove("dropped");
    for (const name of DROPPED_FIRST) {
      if (row.scrollWidth <= row.clientWidth) return;
      parts.find((part) => part.classList.contains(name))?.classList.add("dropped");
    }
  }

  /** Whether something has a button in the bar now. @param {string} name */
  shows(name) {
    const part = this.row.querySelector(`.${name}`);
    return part instanceof HTMLElement && !part.hidden && !part.classList.contains("dropped");
  }

  /**
   * @param {boolean} isPlaying
   * @param {boolean} isLargeShown whether the large button over the picture does the same
   */
  showPlaying(isPlaying, isLargeShown) {
    const { playButton, t } = this;
    if (isPlaying) rename(playButton, t("Pause"), "K", "pause");
    else rename(playButton, t("Play"), "K", "play");
    if (isLargeShown === playButton.hasAttribute("aria-hidden")) return;
    // One stop of the Tab key for one action.
    playButton.toggleAttribute("aria-hidden", isLargeShown);
    if (isLargeShown) playButton.setAttribute("aria-hidden", "true");
    playButton.tabIndex = isLargeShown ? -1 : 0;
  }

  /** @param {boolean} isFull */
  showFull(isFull) {
    const { fullButton, t } = this;
    if (isFull) rename(fullButton, t("Exit full screen"), "F", "window");
    else rename(fullButton, t("Full screen"), "F", "full");
  }

  /** Shows which toggles are on. */
  showToggles() {
    for (const { name, isOn } of this.commands) {
      if (isOn) this.buttons.get(name)?.setAttribute("aria-pressed", String(isOn()));
    }
  }

  /** Shows the values of the choices. */
  showChoices() {
    for (const choice of this.choices) {
      const made = this.buttons.get(choice.name);
      if (made === undefined) continue;
      const { label } = valueOf(choice);
      if (made.textContent !== label) made.textContent = label;
      made.hidden = !choice.isThere();
      made.setAttribute("aria-label", `${choice.label}: ${label}`);
      made.title = choice.label;
    }
  }
}

/** The value that a choice has now. @param {Choice} choice */
export function valueOf({ values, now }) {
  const at = now();
  return values().find(({ value }) => value === at) ?? { value: at, label: String(at) };
}

/**
 * @param {string} name
 * @param {string} label
 * @param {string} key
 * @param {() => void} action
 */
function button(name, label, key, action) {
  const title = key === "" ? label : `${label} (${key})`;
  const made = node("button", { class: name, "aria-label": label, title });
  made.addEventListener("click", action);
  return made;
}

/**
 * @param {string} label
 * @param {(at: number | null) => void} open
 */
function menuButton(label, open) {
  const attributes = { class: "more", "aria-label": label, title: label };
  const made = node("button", { ...attributes, "aria-haspopup": "menu" }, icon("menu"));
  made.setAttribute("aria-expanded", "false");
  made.addEventListener("click", () => open(null));
  made.addEventListener("keydown", (event) => {
    if (event.key !== "ArrowDown" && event.key !== "ArrowUp") return;
    event.preventDefault();
    event.stopPropagation();
    open(event.key === "ArrowUp" ? -1 : 0);
  });
  return made;
}

/**
 * @param {HTMLButtonElement} made
 * @param {string} label
 * @param {string} key
 * @param {import("./icons.js").IconName} iconName
 */
function rename(made, label, key, iconName) {
  // This runs ten times a second, and every change to the DOM costs a layout.
  if (made.getAttribute("aria-label") === label && made.firstChild) return;
  made.replaceChildren(icon(iconName));
  made.setAttribute("aria-label", label);
  made.title = `${label} (${key})`;
}
