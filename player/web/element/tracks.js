/**
 * What goes with the picture: its sound. It is loaded with the first stream that has any: a bundle has
 * it in a file of its own.
 */

import { SoundPlay } from "../sound/soundplay.js";
import { SOUND_STYLE, SoundControls } from "./soundcontrols.js";

/**
 * How the element is told something.
 * @typedef {object} Outlet
 * @property {(message: string) => void} say a sentence to the viewer
 * @property {() => void} added there are more keys
 */

/** The sound of the streams that an element opens, and its controls. */
export class Tracks {
  /** @type {SoundPlay | null} */
  sound = null;

  /**
   * @param {import("./swingsplayer.js").SwingsPlayerElement} element
   * @param {import("./webplayer.js").WebPlayer} player
   * @param {HTMLElement} place of the controls, with the bar
   * @param {import("./keys.js").KeyAction[]} actions
   * @param {Outlet} outlet
   * @param {AbortSignal} signal ends it
   */
  constructor(element, player, place, actions, outlet, signal) {
    this.element = element;
    this.player = player;
    this.outlet = outlet;
    this.signal = signal;
    const controls = new SoundControls(element);
    this.controls = controls;
    controls.unblock = () => this.sound?.unblock();
    const sheet = new CSSStyleSheet();
    sheet.replaceSync(SOUND_STYLE);
    const root = place.getRootNode();
    if (root instanceof ShadowRoot) root.adoptedStyleSheets.push(sheet);
    place.querySelector(".play")?.after(controls.mute, controls.volume);
    place.append(controls.unmute);
    actions.push({
      keys: ["m"],
      label: "Mute or unmute",
      run: () => this.sound && controls.toggle(),
    });
    outlet.added();
    element.addEventListener("volumechange", () => this.#show(), { signal });
    signal.addEventListener("abort", () => this.#close());
  }

  /** The player has opened a stream. */
  open() {
    this.#close();
    const { player, element, outlet, signal } = this;
    const { sound } = player.manifest ?? {};
    if (signal.aborted || !sound) return this.#show();
    try {
      this.sound = new SoundPlay(player, () => element.isLooping);
    } catch (error) {
      const why = error instanceof Error ? error.message : error;
      outlet.say(`The sound of this stream cannot be played: ${why}`);
      return this.#show();
    }
    if (this.sound.sources.length === 0) this.#close();
    this.sound?.addEventListener("blocked", () => this.#show());
    this.sound?.addEventListener("refused", (event) =>
      outlet.say(/** @type {CustomEvent<string>} */ (event).detail),
    );
    this.#show();
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
