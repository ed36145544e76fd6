/** The bar: its buttons with their icons, and when it is hidden. */

import { drawn, node } from "../element/nodes.js";

/** Icon paths on a grid of 24 by 24; icons that only the menu uses are in menu.js. */
const PATHS = {
  play: "M8 5v14l11-7z",
  pause: "M7 5h4v14H7zm6 0h4v14h-4z",
  reset: "M12 3l9.5 8.5H19V20h-5.5v-6h-3v6H5v-8.5H2.5z",
  share: "M14 9V5l7 7-7 7v-4C8 15 5 17 3 20c1-6 4-10 11-11z",
  headset:
    "M4 7h16a2 2 0 0 1 2 2v6a2 2 0 0 1-2 2h-4l-2.5-3h-3L8 17H4a2 2 0 0 1-2-2V9a2 2 0 0 1 2-2zm2 3v3h4v-3zm8 0v3h4v-3z",
  menu: "M12 4a2 2 0 1 1 0 4 2 2 0 0 1 0-4zm0 6a2 2 0 1 1 0 4 2 2 0 0 1 0-4zm0 6a2 2 0 1 1 0 4 2 2 0 0 1 0-4z",
  full: "M5 5h6v2H7v4H5zm14 0v6h-2V7h-4V5zM5 13h2v4h4v2H5zm12 0h2v6h-6v-2h4z",
  window: "M9 5h2v6H5V9h4zm4 0h2v4h4v2h-6zm-8 8h6v6H9v-4H5zm8 0h6v2h-4v4h-2z",
};

/** @typedef {keyof typeof PATHS} IconName */

/** @param {IconName} name */
export function icon(name) {
  return drawn(PATHS[name]);
}

/** @typedef {import("./commands.js").Command} Command */
/** @typedef {import("./menu.js").Choice} Choice */

/** Parts that leave a row without room for all, in this order; the menu has most of them then. */
const DROPPED_FIRST = "volume rate reset quality cc headset mute time share".split(" ");

/**
 * What the bar's buttons do, other than commands.
 * @typedef {object} BarActions
 * @property {() => void} togglePlaying @property {() => void} toggleFullScreen
 * @property {(opener: HTMLElement, at: number | Choice | null) => void} openMenu focuses entry `at` (-1: the
 *   last one), or shows the values of a choice; null toggles the menu
 */

/** The scrub bar, and under it one row of buttons. */
export class Bar {
  /**
   * @param {import("./scrubber.js").Scrubber} scrubber @param {HTMLElement} badge @param {Choice[]} choices
   * @param {Command[]} commands @param {import("./texts.js").Translate} t @param {BarActions} actions
   */
  constructor(scrubber, badge, choices, commands, t, actions) {
    this.t = t;
    this.playButton = button("play", t("Play"), "K", actions.togglePlaying);
    this.fullButton = button("full", t("Full screen"), "F", actions.toggleFullScreen);
    this.menuButton = menuButton(t("More"), (at) => actions.openMenu(this.menuButton, at));
    /** @type {Choice[]} */ this.choices = choices;
    /** @type {Command[]} */ this.commands = commands;
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
    /** @type {HTMLButtonElement} */ this.headset = headset;
    /** @type {HTMLSpanElement} */ this.time = scrubber.time;
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
   * @param {boolean} isPlaying @param {boolean} isLargeShown whether the large button over the picture does the same
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

/** @param {string} name @param {string} label @param {string} key @param {() => void} action */
function button(name, label, key, action) {
  const title = key === "" ? label : `${label} (${key})`;
  const made = node("button", { class: name, "aria-label": label, title });
  made.addEventListener("click", action);
  return made;
}

/** @param {string} label @param {(at: number | null) => void} open */
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

/** @param {HTMLButtonElement} made @param {string} label @param {string} key @param {IconName} iconName */
function rename(made, label, key, iconName) {
  // This runs ten times a second, and every change to the DOM costs a layout.
  if (made.getAttribute("aria-label") === label && made.firstChild) return;
  made.replaceChildren(icon(iconName));
  made.setAttribute("aria-label", label);
  made.title = `${label} (${key})`;
}

const IDLE_MS = 2500;

/**
 * Shows and hides the bar. It shows during user activity, and always unless the stream plays. Moving the
 * mouse shows it; a tap on the picture shows or hides it.
 */
export class BarVisibility {
  #timer = 0;

  /**
   * @param {HTMLElement} frame gets the class `idle` while the bar is hidden @param {HTMLElement} canvas
   * @param {() => boolean} plays @param {() => boolean} isInUse whether a part of the bar is in use
   * @param {(isIdle: boolean) => void} changed called when the bar was hidden or shown
   */
  constructor(frame, canvas, plays, isInUse, changed) {
    this.changed = changed;
    /** @type {HTMLElement} */ this.frame = frame;
    /** @type {HTMLElement} */ this.canvas = canvas;
    /** @type {() => boolean} */ this.plays = plays;
    /** @type {() => boolean} */ this.isInUse = isInUse;
  }

  /**
   * @param {HTMLElement} element @param {() => void} toggleFullScreen @param {AbortSignal} signal ends the listening
   */
  listen(element, toggleFullScreen, signal) {
    const { canvas } = this;
    let lastPointer = "mouse";
    const onPointer = (/** @type {PointerEvent} */ event) => {
      lastPointer = event.pointerType;
      // A touch on the picture shows the bar only once it is known to be a tap: a bar that shows at once
      // would receive the tap.
      const isOnPicture = event.composedPath()[0] === canvas;
      if (event.pointerType !== "touch" || !isOnPicture) this.wake();
    };
    for (const type of /** @type {const} */ (["pointermove", "pointerdown"]))
      element.addEventListener(type, onPointer, { signal });
    const leave = (/** @type {PointerEvent} */ event) => {
      if (event.pointerType === "mouse") this.#rest();
    };
    element.addEventListener("pointerleave", leave, { signal });
    for (const type of ["keydown", "focusin", "play", "pause", "ended"])
      element.addEventListener(type, () => this.wake(), { signal });
    const tap = () => {
      if (lastPointer === "touch") this.toggle();
    };
    canvas.addEventListener("click", tap, { signal });
    const double = (/** @type {MouseEvent} */ event) => {
      if (lastPointer === "mouse" && !event.altKey) toggleFullScreen();
    };
    canvas.addEventListener("dblclick", double, { signal });
    signal.addEventListener("abort", () => clearTimeout(this.#timer));
  }

  /** Shows the bar for some time. */
  wake() {
    this.#setIdle(false);
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#rest(), IDLE_MS);
  }

  toggle() {
    if (this.frame.classList.contains("idle")) this.wake();
    else this.#rest();
  }

  #rest() {
    if (!this.plays()) return;
    if (this.isInUse()) this.wake();
    else this.#setIdle(true);
  }

  /** @param {boolean} isIdle */
  #setIdle(isIdle) {
    this.frame.classList.toggle("idle", isIdle);
    this.changed(isIdle);
  }
}
