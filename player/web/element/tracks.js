/**
 * The sound and captions of a stream. This code is loaded with the first stream that has any; a bundle has
 * it in a separate file.
 */

import CAPTIONS_STYLE from "./captions.css";
import { CaptionsControls } from "./captionscontrols.js";
import { addStyle } from "./nodes.js";
import { RemoteControl } from "./remotecontrol.js";
import { SoundPlay } from "../sound/soundplay.js";
import SOUND_STYLE from "./sound.css";
import { SoundControls } from "./soundcontrols.js";

export { translatorOf } from "./texts.js";

const LONG_MS = 10_000;

/** Shared by all elements, which may be created and removed many times. */
const SHEET = new CSSStyleSheet();
SHEET.replaceSync(SOUND_STYLE + CAPTIONS_STYLE);

/** The sound and the captions of the streams that an element opens, and their controls. */
export class Tracks {
  /** @type {SoundPlay | null} */
  sound = null;

  /**
   * @param {import("./swingsplayer.js").SwingsPlayerElement} element
   * @param {import("./webplayer.js").WebPlayer} player
   * @param {HTMLElement} place the element that holds the controls
   * @param {import("./hints.js").Hints} hints
   * @param {HTMLVideoElement} textHolder of the text tracks that scripts see
   * @param {import("./texts.js").Translate} t
   * @param {AbortSignal} signal ends sound, captions and listening
   */
  constructor(element, player, place, hints, textHolder, t, signal) {
    this.t = t;
    this.element = element;
    this.player = player;
    this.hints = hints;
    this.signal = signal;
    const controls = new SoundControls(element, t);
    this.controls = controls;
    controls.unblock = () => this.sound?.unblock();
    const say = (/** @type {string} */ message) => this.#say(message);
    this.captions = new CaptionsControls(player, textHolder, say, t, signal);
    this.remote = new RemoteControl(element, player, signal);
    addStyle(place, SHEET);
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
