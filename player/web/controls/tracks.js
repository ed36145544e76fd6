/**
 * The sound and captions of a stream. This code is loaded with the first stream that has any; a bundle has it
 * in a separate file.
 */

import { addStyle, drawn, node } from "../element/nodes.js";
import { SoundPlay } from "../sound/soundplay.js";
import { pictureUrl } from "../source/addresses.js";
import { CaptionsControls } from "./captions.js";
import STYLE from "./tracks.css";

const SPEAKER = "M3 9v6h4l5 5V4L7 9z";
const ICONS = {
  heard: `${SPEAKER}M14 7.5v9a5 5 0 0 0 0-9z`,
  silent: `${SPEAKER}M15.4 8L14 9.4l2.6 2.6-2.6 2.6 1.4 1.4 2.6-2.6 2.6 2.6 1.4-1.4-2.6-2.6L22 9.4 20.6 8 18 10.6z`,
};

/** Mute and volume in the bar, and a button over the picture if the browser requires a user gesture. */
class SoundControls {
  isBlocked = false;
  unblock = () => {};
  mute = node("button", { class: "mute" });

  /**
   * @param {import("../element/mediainterface.js").MediaInterface} element @param {import("./texts.js").Translate} t
   */
  constructor(element, t) {
    this.element = element;
    this.t = t;
    this.mute.addEventListener("click", () => this.toggle());
    const range = { type: "range", min: "0", max: "1", step: "0.05", "aria-label": t("Volume") };
    this.volume = node("input", { class: "volume slider", ...range });
    this.volume.addEventListener("input", () => {
      element.volume = this.volume.valueAsNumber;
      element.muted = false;
      this.unblock();
    });
    // These keys move the volume's thumb; the player must not also seek.
    this.volume.addEventListener("keydown", (event) => {
      if (/^(Arrow|Home|End|Page)/.test(event.key)) event.stopPropagation();
    });
    this.unmute = node(
      "button",
      { class: "unmute", hidden: true },
      drawn(ICONS.silent),
      t("Unmute"),
    );
    this.unmute.addEventListener("click", () => this.toggle());
  }

  /** Whether nothing can be heard, for whatever reason. */
  get isSilent() {
    return this.element.muted || this.element.volume === 0 || this.isBlocked;
  }

  toggle() {
    const { element } = this;
    if (!this.isSilent) {
      element.muted = true;
      return;
    }
    if (element.volume === 0) element.volume = 1;
    element.muted = false;
    this.unblock();
  }

  /** @param {boolean} isThere whether there is sound to control */
  show(isThere) {
    const { mute, volume, unmute, element, isSilent, t } = this;
    mute.hidden = volume.hidden = !isThere;
    unmute.hidden = !isThere || !this.isBlocked;
    const label = isSilent ? t("Unmute") : t("Mute");
    const heard = element.muted ? 0 : element.volume;
    volume.value = String(heard);
    const end = `${100 * heard}%`;
    const track = `linear-gradient(to right, var(--played) ${end}, var(--rest) ${end})`;
    volume.style.setProperty("--track", track);
    if (mute.getAttribute("aria-label") === label) return;
    mute.replaceChildren(drawn(isSilent ? ICONS.silent : ICONS.heard));
    mute.setAttribute("aria-label", label);
    mute.title = `${label} (M)`;
  }
}

/** Seconds that a key for a step goes, where the device does not say. */
const STEP_S = 10;
const ACTIONS = /** @type {const} */ (["play", "pause", "seekto", "seekbackward", "seekforward"]);

/** @type {RemoteControl | null} the one that the page's media session belongs to: who was heard last */
let owner = null;

/**
 * What a device offers for a player that is heard outside of the page: on the lock screen, in notifications, by
 * the media keys of a keyboard or headphones.
 */
export class RemoteControl {
  /** @type {number} counts streams, because a poster may arrive late */
  #opened = 0;

  /**
   * @param {import("../element/swingsplayer.js").SwingsPlayerElement} element
   * @param {import("../element/webplayer.js").WebPlayer} player @param {AbortSignal} signal ends it
   */
  constructor(element, player, signal) {
    this.element = element;
    this.player = player;
    const on = (/** @type {string[]} */ types, /** @type {() => void} */ action) => {
      for (const type of types) element.addEventListener(type, action, { signal });
    };
    on(["play", "volumechange"], () => this.show());
    on(["pause", "ended", "seeked", "ratechange", "durationchange"], () => this.#update());
    on(["emptied"], () => this.#release());
    signal.addEventListener("abort", () => this.#release());
  }

  /** Takes the page's media session over if this player can be heard. */
  show() {
    const { element, player } = this;
    const isHeard = !element.paused && !element.muted && element.volume > 0;
    if (!navigator.mediaSession || !isHeard || !player.manifest?.sound) return;
    if (owner !== this) {
      owner = this;
      for (const action of ACTIONS)
        navigator.mediaSession.setActionHandler(action, (details) => this.#act(action, details));
      this.#describe();
    }
    this.#update();
  }

  async #describe() {
    const { element, player } = this;
    const { title, poster } = /** @type {import("../playback/messages.js").OpenManifest} */ (
      player.manifest
    );
    const metadata = { title: title || document.title };
    navigator.mediaSession.metadata = new MediaMetadata(metadata);
    const opened = this.#opened;
    try {
      const url = element.poster || (poster && (await pictureUrl(player, poster)));
      if (!url || owner !== this || opened !== this.#opened) return;
      navigator.mediaSession.metadata = new MediaMetadata({ ...metadata, artwork: [{ src: url }] });
    } catch (error) {
      console.warn("swings: the device shows no poster:", error);
    }
  }

  /** @param {(typeof ACTIONS)[number]} action @param {MediaSessionActionDetails} details */
  #act(action, { seekTime, seekOffset }) {
    const { element } = this;
    const byS = seekOffset ?? STEP_S;
    const seek = (/** @type {number} */ timeS) =>
      (element.currentTime = Math.max(0, Math.min(element.duration, timeS)));
    if (action === "play") element.play();
    else if (action === "pause") element.pause();
    else if (action === "seekto") seek(seekTime ?? element.currentTime);
    else seek(element.currentTime + (action === "seekforward" ? byS : -byS));
  }

  #update() {
    if (owner !== this) return;
    const { mediaSession } = navigator;
    const { paused, duration, currentTime, playbackRate } = this.element;
    mediaSession.playbackState = paused ? "paused" : "playing";
    // A live stream has no length.
    if (this.player.live || !(duration > 0)) mediaSession.setPositionState?.();
    else mediaSession.setPositionState?.({ duration, position: currentTime, playbackRate });
  }

  #release() {
    this.#opened += 1;
    if (owner !== this) return;
    owner = null;
    const { mediaSession } = navigator;
    mediaSession.metadata = null;
    mediaSession.playbackState = "none";
    mediaSession.setPositionState?.();
    for (const action of ACTIONS) mediaSession.setActionHandler(action, null);
  }
}

export { translatorOf } from "./texts.js";

const LONG_MS = 10_000;

/** The sound and the captions of the streams that an element opens, and their controls. */
export class Tracks {
  /** @type {SoundPlay | null} */
  sound = null;

  /**
   * @param {import("../element/swingsplayer.js").SwingsPlayerElement} element
   * @param {import("../element/webplayer.js").WebPlayer} player
   * @param {HTMLElement} place the element that holds the controls
   * @param {import("../element/overlay.js").Hints} hints
   * @param {HTMLVideoElement} textHolder of the text tracks that scripts see
   * @param {import("./texts.js").Translate} t @param {AbortSignal} signal ends sound, captions and listening
   */
  constructor(element, player, place, hints, textHolder, t, signal) {
    this.t = t;
    this.element = element;
    this.player = player;
    this.hints = hints;
    /** @type {AbortSignal} */ this.signal = signal;
    const controls = new SoundControls(element, t);
    /** @type {SoundControls} */ this.controls = controls;
    controls.unblock = () => this.sound?.unblock();
    const say = (/** @type {string} */ message) => this.#say(message);
    this.captions = new CaptionsControls(player, textHolder, say, t, signal);
    this.remote = new RemoteControl(element, player, signal);
    addStyle(place, STYLE);
    place.prepend(this.captions.text);
    place.append(controls.unmute);
    element.addEventListener("volumechange", () => this.#show(), { signal });
    element.addEventListener("emptied", () => this.open(), { signal });
    // Safari lets sound begin only during a user gesture.
    const press = () => !element.muted && this.sound?.unblock();
    for (const type of ["click", "keydown"]) element.addEventListener(type, press, { signal });
    signal.addEventListener("abort", () => this.#close());
  }

  /** Adds what belongs in the bar, the menu and the list of keys. @param {import("./controls.js").Controls} to */
  addTo({ bar, choices, commands, actions }) {
    const { controls, captions } = this;
    bar.playButton.after(controls.mute, controls.volume);
    bar.row.querySelector(".space")?.after(captions.button);
    choices.push(captions.choice);
    const mute = { name: "mute", label: "Mute", key: "m", run: () => controls.toggle() };
    const isOn = () => controls.isSilent;
    commands.unshift({ ...mute, isOn, isThere: () => this.sound !== null });
    actions.push({ keys: ["m"], label: "Mute or unmute", run: () => this.sound && mute.run() });
    actions.push({ keys: ["c"], label: "Captions", run: () => captions.next() });
  }

  /** @param {string} message */
  #say(message) {
    this.hints.say(message, LONG_MS);
  }

  /** Called when the player has opened or closed a stream. */
  open() {
    this.#close();
    const { player, element, signal } = this;
    const { sound, captions } = player.manifest ?? {};
    try {
      this.captions.open(captions);
    } catch (error) {
      const why = error instanceof Error ? error.message : String(error);
      this.#say(this.t("The captions of this stream cannot be shown: {why}", { why }));
    }
    if (signal.aborted || !sound) return this.#show();
    try {
      this.sound = new SoundPlay(player, () => element.isLooping);
    } catch (error) {
      const why = error instanceof Error ? error.message : String(error);
      this.#say(this.t("The sound of this stream cannot be played: {why}", { why }));
      return this.#show();
    }
    if (this.sound.sources.length === 0) this.#close();
    this.sound?.addEventListener("blocked", () => this.#show());
    this.sound?.addEventListener("refused", (event) =>
      this.#say(
        this.t("Some of the sound cannot be played: {why}", {
          why: /** @type {CustomEvent<string>} */ (event).detail,
        }),
      ),
    );
    this.#show();
    this.remote.show(); // it may play already
  }

  #show() {
    const { sound, controls, element } = this;
    if (sound !== null && (sound.isMuted !== element.muted || element.volume !== sound.volume))
      sound.setVolume(element.volume, element.muted);
    controls.isBlocked = sound?.isBlocked ?? false;
    controls.show(sound !== null);
  }

  #close() {
    this.sound?.close();
    this.sound = null;
  }
}
