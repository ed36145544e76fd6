import { icon } from "./icons.js";
import { node } from "./nodes.js";

/** @typedef {import("./commands.js").Command} Command */
/** @typedef {import("./menu.js").Choice} Choice */

/** The row of buttons under the picture. */
export class Bar {
  /**
   * @param {object} parts
   * @param {import("./scrubber.js").Scrubber} parts.scrubber
   * @param {HTMLElement} parts.badge
   * @param {(at: number | null) => void} parts.openMenu focuses entry `at` (-1: the last one); null toggles
   *   the menu
   * @param {Choice[]} choices
   * @param {Command[]} commands
   * @param {() => void} togglePlaying
   * @param {() => void} toggleFullScreen
   */
  constructor({ scrubber, badge, openMenu }, choices, commands, togglePlaying, toggleFullScreen) {
    this.playButton = button("play", "Play", "K", togglePlaying);
    this.fullButton = button("full", "Full screen", "F", toggleFullScreen);
    this.menuButton = menuButton(openMenu);
    this.choices = choices;
    this.commands = commands;
    this.selects = choices.map((choice) => {
      const select = node("select", { class: `${choice.name} wide`, "aria-label": choice.label });
      select.addEventListener("change", () => choice.choose(Number(select.value)));
      return select;
    });
    /** @type {Map<string, HTMLButtonElement>} */
    this.buttons = new Map();
    for (const { name, label, icon: iconName, key, place, run } of commands) {
      if (iconName === undefined) continue; // only in the menu
      const made = button(name, label, key.toUpperCase(), run);
      made.append(icon(iconName));
      made.classList.toggle("wide", place === "wide");
      this.buttons.set(name, made);
    }
    const { headset, ...others } = Object.fromEntries(this.buttons);
    headset.hidden = true;
    this.headset = headset;
    this.root = node(
      "div",
      { class: "bar", part: "bar" },
      scrubber.root,
      this.playButton,
      scrubber.time,
      badge,
      node("span", { class: "space" }),
      ...Object.values(others),
      ...this.selects,
      headset,
      this.menuButton,
      this.fullButton,
    );
    this.showPlaying(false);
    this.showFull(false);
    this.showChoices();
  }

  /** @param {boolean} isPlaying */
  showPlaying(isPlaying) {
    if (isPlaying) rename(this.playButton, "Pause", "K", "pause");
    else rename(this.playButton, "Play", "K", "play");
  }

  /** @param {boolean} isFull */
  showFull(isFull) {
    if (isFull) rename(this.fullButton, "Exit full screen", "F", "window");
    else rename(this.fullButton, "Full screen", "F", "full");
  }

  /** Shows which toggles are on. */
  showToggles() {
    for (const { name, isOn } of this.commands) {
      if (isOn) this.buttons.get(name)?.setAttribute("aria-pressed", String(isOn()));
    }
  }

  /** Fills the selects, and shows their values. */
  showChoices() {
    for (const [n, { values, now }] of this.choices.entries()) {
      const options = values().map(({ value, label }) => new Option(label, String(value)));
      this.selects[n].replaceChildren(...options);
      this.selects[n].value = String(now());
    }
  }
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

/** @param {(at: number | null) => void} open */
function menuButton(open) {
  const made = node(
    "button",
    { class: "more", "aria-label": "More", title: "More", "aria-haspopup": "menu" },
    icon("menu"),
  );
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
