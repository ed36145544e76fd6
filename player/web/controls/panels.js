/** The panels over the picture: the menu, the statistics, the list of keys, and why a stream cannot be played. */

import { node } from "../element/nodes.js";
import { scenePointAt } from "./cameracontrols.js";

import { Menu } from "./menu.js";

const ARROWS = {
  arrowleft: "←",
  arrowright: "→",
  arrowup: "↑",
  arrowdown: "↓",
};

/** The dialog that lists the keys. */
class KeyList {
  list = node("dl");

  /**
   * @param {import("./keys.js").KeyAction[]} actions read whenever the list opens
   * @param {import("./texts.js").Translate} t
   */
  constructor(actions, t) {
    this.actions = actions;
    this.t = t;
    const close = node("button", { class: "close" }, t("Close"));
    close.addEventListener("click", () => this.root.close());
    const attributes = { class: "keylist", "aria-labelledby": "keys" };
    const header = node("header", {}, node("h2", { id: "keys" }, t("Keys")), close);
    /** @type {HTMLDialogElement} */ this.root = node("dialog", attributes, header, this.list);
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

const PERIOD_MS = 250;

/** A panel of numbers about the play. */
class Statistics {
  #timer = 0;
  /** Where the pointer is over the picture, CSS pixels. @type {[number, number] | null} */
  #pointer = null;
  root = node("pre", { class: "stats", hidden: true });

  /** @param {import("../element/webplayer.js").WebPlayer} player */
  constructor(player) {
    this.player = player;
    player.canvas.addEventListener("pointermove", ({ offsetX, offsetY }) => {
      this.#pointer = [offsetX, offsetY];
    });
    player.canvas.addEventListener("pointerleave", () => (this.#pointer = null));
  }

  get isOn() {
    return !this.root.hidden;
  }

  toggle() {
    this.root.hidden = !this.root.hidden;
    clearInterval(this.#timer);
    if (!this.isOn) return;
    const write = () => (this.root.textContent = this.#text());
    write();
    this.#timer = setInterval(write, PERIOD_MS);
  }

  close() {
    clearInterval(this.#timer);
  }

  #text() {
    const { player } = this;
    if (player.manifest === null) return "";
    const { state, timings, manifest, renderer } = player;
    const ms = (/** @type {number} */ value) => `${value.toFixed(1)} ms`;
    const buffered = (state.endFrame - state.frame) / manifest.fps;
    const rate =
      state.rateBps === null ? "rate not known yet" : `${(state.rateBps / 1e6).toFixed(1)} Mbit/s`;
    const point = this.#pointer && scenePointAt(player.view, ...this.#pointer);
    return [
      `frame     ${state.frame} of ${player.numFrames}, ${manifest.fps} per second`,
      `pictures  ${timings.framesPerS.toFixed(0)} per second`,
      `buffer    ${buffered.toFixed(1)} s, ${state.stalls} stalls`,
      `link      ${rate}, ${(state.receivedBytes / 1e6).toFixed(1)} MB so far`,
      `Gaussians ${renderer?.numDrawn ?? 0} drawn, ${manifest.numGs} slots`,
      `layers    ${state.layers} of ${manifest.numLayers}`,
      `decode    ${ms(state.decodeMs)}`,
      `sort      ${ms(timings.sortMs)}`,
      `upload    ${ms(timings.uploadMs)}, ${((renderer?.uploadedBytes ?? 0) / 1e6).toFixed(1)} MB so far`,
      `draw      ${ms(timings.drawMs)}`,
      `pointer   ${point?.map((metres) => metres.toFixed(3)).join(" ") ?? "-"}`,
    ].join("\n");
  }
}

/** The panels that commands open over the picture: the menu, the statistics and the list of keys. */
export class Panels {
  /**
   * @param {import("../element/webplayer.js").WebPlayer} player @param {HTMLElement} place
   * @param {object} parts @param {import("./bar.js").Bar} parts.bar
   * @param {import("./menu.js").Choice[]} parts.choices @param {import("./commands.js").Command[]} parts.commands
   * @param {import("./keys.js").KeyAction[]} parts.actions @param {import("./texts.js").Translate} t
   * @param {() => void} changed called when the menu was opened or closed
   */
  constructor(player, place, { bar, choices, commands, actions }, t, changed) {
    this.menu = new Menu(bar, choices, commands, t, changed);
    this.statistics = new Statistics(player);
    this.keyList = new KeyList(actions, t);

    place.append(this.statistics.root, this.menu.root, this.keyList.root);
  }

  /** Whether the bar has to stay. */
  get isInUse() {
    return this.menu.isOpen || this.keyList.root.open;
  }
}

/** Texts shown instead of messages that contain a URL or a status; the first matching pattern applies. */
const SENTENCES = /** @type {[RegExp, string][]} */ ([
  [/HTTP 40[13]\b/, "You have no access to this video."],
  [/HTTP (404|410)\b/, "This video does not exist, or is not here any more."],
  [/HTTP 5\d\d\b/, "The host of this video has a problem. Try again in a while."],
  [/does not let pages of other hosts/, "The host of this video does not let this page show it."],
  [
    /does not answer|cannot be reached/,
    "The host of this video cannot be reached. Check the network and try again.",
  ],
  [/damaged on the server/, "This video is damaged on its server."],
  [/https?:|file:/, "This video cannot be played."],
]);

const NO_WEBGL = /no WebGL2/;

/** Longer messages are replaced by a general sentence, and shown folded below it. */
const MOST_CHARS = 120;

/** @param {string} message */
export function sentenceOf(message) {
  const found = SENTENCES.find(([pattern]) => pattern.test(message));
  if (found) return found[1];
  if (message.length > MOST_CHARS) return "This video cannot be played.";
  return message.endsWith(".") ? message : `${message}.`;
}

/** The panel that shows why playback failed, with a button to try again and the folded details. */
export class Failure {
  /** Whether another try would not help: a browser without WebGL2 will not have it then. */
  isFinal = false;
  sentence = node("p", { class: "sentence" });
  details = node("p", { class: "note" });

  /** @param {() => void} retry @param {import("./texts.js").Translate} t */
  constructor(retry, t) {
    this.t = t;
    this.retryButton = node("button", { class: "retry" }, t("Try again"));
    this.retryButton.addEventListener("click", retry);
    this.fold = node("details", {}, node("summary", {}, t("Details")), this.details);
    const parts = [this.sentence, this.retryButton, this.fold];
    this.root = node("div", { class: "failure", role: "alert", hidden: true }, ...parts);
  }

  /** @param {string} message */
  show(message) {
    const sentence = sentenceOf(message);
    const isPlain = sentence === message || sentence === `${message}.`;
    this.sentence.textContent = isPlain
      ? sentence.replace(message, () => this.t(message))
      : this.t(sentence);
    this.details.textContent = message;
    this.isFinal = NO_WEBGL.test(message);
    this.retryButton.hidden = this.isFinal;
    this.root.classList.toggle("final", this.isFinal);
    this.fold.hidden = isPlain;
    this.fold.open = false;
    this.root.hidden = false;
  }

  clear() {
    this.isFinal = false;
    this.details.textContent = "";
    this.root.hidden = true;
  }
}
