/**
 * The controls of a player: everything that a viewer can press, and the panel for failures. This code is loaded after
 * the first requests of a stream, and its bundle is a separate file, so that it does not delay the first picture.
 */

import { addStyle, prefersStill } from "../element/nodes.js";
import { Turntable } from "../view/flight.js";
import { Bar, BarVisibility } from "./bar.js";
import { CameraControls } from "./cameracontrols.js";
import { choicesOf, commandsOf } from "./commands.js";
import STYLE from "./controls.css";
import { keysOf, pressKey } from "./keys.js";
import { Failure, Panels } from "./panels.js";
import { LiveBadge, Scrubber } from "./scrubber.js";
import { Sharing } from "./sharing.js";
import { StereoControls } from "./stereocontrols.js";
import { SlideShow } from "./storyboard.js";
import { FullScreen } from "./windows.js";

const KEY = "swings-player-looked";
const FOR_MS = 6000;

/**
 * Tells a viewer, once in this browser, that one may look around: when the first picture moves, unless the
 * viewer has tried already.
 * @param {import("../element/webplayer.js").WebPlayer} player
 * @param {import("../element/overlay.js").Hints} hints @param {AbortSignal} signal ends the listening
 */
function hintToLook(player, hints, signal) {
  if (wasSaid()) return;
  const ending = new AbortController();
  const end = () => {
    ending.abort();
    remember();
  };
  const options = { signal: AbortSignal.any([signal, ending.signal]) };
  player.canvas.addEventListener("pointerdown", end, options);
  player.addEventListener(
    "shown",
    () => {
      if (!player.isStill && !player.state.playing) return;
      end();
      const isTouch = matchMedia("(pointer: coarse)").matches;
      const ownsFinger = player.canvas.style.touchAction === "none";
      if (!isTouch) hints.say("Drag to look around", FOR_MS);
      else if (ownsFinger) hints.say("Drag with a finger to look around", FOR_MS);
      else hints.say("Drag with two fingers to look around", FOR_MS);
    },
    options,
  );
}

function wasSaid() {
  try {
    return localStorage.getItem(KEY) !== null;
  } catch (error) {
    console.info("swings: this page may not remember anything:", error);
    return true;
  }
}

function remember() {
  try {
    localStorage.setItem(KEY, "1");
  } catch (error) {
    console.info("swings: this browser does not remember that the hint was shown:", error);
  }
}

const LONG_MS = 10_000;

/**
 * What an element gives to its controls.
 * @typedef {object} Surroundings
 * @property {import("../element/swingsplayer.js").SwingsPlayerElement} element
 * @property {import("../element/webplayer.js").WebPlayer} player @property {HTMLCanvasElement} canvas
 * @property {HTMLElement} frame holds everything
 * @property {HTMLElement} place for the controls, within the frame
 * @property {import("../element/overlay.js").Overlay} overlay
 * @property {import("../element/overlay.js").Hints} hints
 * @property {() => void} changed called when the element's condition may have changed
 * @property {(isIdle: boolean) => void} setIdle called when the bar was hidden or shown
 */

export { translatorOf } from "./texts.js";

export class Controls {
  /** @type {SlideShow | null} */
  #slides = null;

  /**
   * @param {Surroundings} surroundings @param {{ t: import("./texts.js").Translate, language: string }} texts
   * @param {AbortSignal} signal ends them
   */
  constructor(surroundings, { t, language }, signal) {
    const { element, player, canvas, frame, place, overlay, hints, changed } = surroundings;
    frame.lang = language;
    canvas.setAttribute("aria-label", t(canvas.getAttribute("aria-label") ?? ""));
    overlay.translate(t);
    hints.translate(t);
    this.element = element;
    this.player = player;
    /** @type {HTMLElement} */ this.frame = frame;
    /** @type {AbortSignal} */ this.signal = signal;
    addStyle(frame, STYLE);
    this.failure = new Failure(() => element.retry(), t);
    this.sharing = new Sharing(element, (message, forMs) => hints.say(message, forMs));
    const stereo = new StereoControls(player, (message) => hints.say(message, LONG_MS));
    this.scrubber = new Scrubber(player, t, signal);
    this.live = new LiveBadge(
      player,
      (hasStopped) => {
        const isSaid = hasStopped && element.error === null;
        hints.hold("stopped", isSaid ? t("The stream has stopped; it may go on") : "");
        this.visibility.wake();
        changed();
      },
      t,
      signal,
    );
    this.live.root.addEventListener("click", () => element.goLive());
    /** @type {import("./commands.js").Command[]} */
    const commands = (this.commands = commandsOf(element, stereo, this.sharing, () => this.panels));
    for (const command of commands) {
      const { run } = command;
      command.run = () => {
        run();
        this.bar.showToggles();
      };
    }
    const choices = (this.choices = choicesOf(element, t));
    this.fullScreen = new FullScreen(
      element,
      () => this.bar.showFull(this.fullScreen.isOn),
      signal,
    );
    this.bar = new Bar(this.scrubber, this.live.root, choices, commands, t, {
      togglePlaying: () => element.togglePlaying(),
      toggleFullScreen: () => this.fullScreen.toggle(),
      openMenu: (opener, at) => this.panels.menu.openFor(opener, at),
    });
    const actions = (this.actions = keysOf(element, player, commands));
    const parts = { bar: this.bar, choices, commands, actions };
    this.panels = new Panels(player, place, parts, t, () => this.visibility.wake());
    this.bar.follow(signal);
    const plays = () => player.isStill || (!element.paused && !this.live.hasStopped);
    const isInUse = () => this.panels.isInUse || this.scrubber.isScrubbing;
    this.visibility = new BarVisibility(frame, canvas, plays, isInUse, surroundings.setIdle);
    this.visibility.listen(element, () => this.fullScreen.toggle(), signal);
    this.camera = new CameraControls(element, canvas, player, t, signal);
    const { headset } = this.bar;
    stereo.watch((isThere) => (headset.hidden = !isThere), signal);
    this.#listen(hints, signal);
    hintToLook(player, hints, signal);
    place.append(this.bar.root);
    frame.append(this.failure.root);
    signal.addEventListener("abort", () => this.#close());
    this.opened();
    this.bar.showFull(false);
    this.show();
    this.visibility.wake();
  }

  /** @param {import("../element/overlay.js").Hints} hints @param {AbortSignal} signal */
  #listen(hints, signal) {
    const { element, player, bar, frame } = this;
    const on = (/** @type {string} */ type, /** @type {(event: any) => void} */ action) =>
      element.addEventListener(type, action, { signal });
    player.addEventListener("headset", () => bar.showToggles(), { signal });
    this.camera.gyroscope.addEventListener("change", () => bar.showToggles(), { signal });
    for (const type of ["ratechange", "layerschange"]) on(type, () => bar.showChoices());
    on("pointerdown", (/** @type {PointerEvent} */ event) => {
      frame.classList.remove("tabbed");
      const path = event.composedPath();
      const { menu } = this.panels;
      if (!path.includes(menu.root) && !path.includes(menu.opener)) menu.close(false);
    });
    // The focus ring shows after Tab, but not after any other key.
    on("keyup", (/** @type {KeyboardEvent} */ { key }) => {
      if (key === "Tab") frame.classList.add("tabbed");
    });
    on("gesturehint", (/** @type {CustomEvent<string>} */ { detail }) => hints.say(detail));
  }

  /** Called when a stream is open. */
  opened() {
    const { element, player, frame, bar } = this;
    frame.classList.toggle("still", player.isStill);
    bar.showChoices();
    bar.showToggles();
    if (player.isStill && !prefersStill() && !element.hasAttribute("view")) this.#turnSlowly();
  }

  /** Shows why the stream cannot be played. @param {string} message */
  fail(message) {
    this.failure.show(message);
    const { manifest, live } = this.player;
    if (this.failure.isFinal && manifest?.storyboard && !live) this.#showSlides();
  }

  #showSlides() {
    if (this.#slides !== null) return;
    this.#slides = new SlideShow(this.player);
    this.failure.root.before(this.#slides.root);
  }

  clearFailure() {
    this.failure.clear();
    this.#slides?.close();
    this.#slides = null;
  }

  /** Turns a model until the viewer does something. */
  #turnSlowly() {
    const { element, player } = this;
    if (player.motion === null) return;
    const turntable = new Turntable(player.motion);
    const ending = new AbortController();
    const signal = AbortSignal.any([this.signal, ending.signal]);
    for (const type of ["pointerdown", "wheel", "keydown", "emptied"])
      element.addEventListener(type, () => ending.abort(), { signal });
    const step = (/** @type {number} */ nowMs) => {
      if (signal.aborted) return;
      requestAnimationFrame(step);
      if (player.shownFrame < 0 || !player.sight.isSeen) return;
      turntable.step(nowMs);
      player.moved();
    };
    requestAnimationFrame(step);
  }

  /** Shows the state of the player. */
  show() {
    const { element, bar, scrubber, frame } = this;
    const isLargeShown = /start|ended/.test(frame.dataset.condition ?? "");
    bar.showPlaying(!element.paused, isLargeShown);
    scrubber.show();
  }

  /**
   * Runs the action of a key that was pressed.
   * @param {KeyboardEvent} event @param {EventTarget} target the innermost one, which an event does not tell later
   */
  press(event, target) {
    if (event.key === "Escape") this.fullScreen.leave();
    else pressKey(this.actions, event, target);
  }

  #close() {
    this.fullScreen.leave();
    this.panels.statistics.close();
    this.scrubber.close();
    this.clearFailure();
    this.failure.root.remove();
  }
}
