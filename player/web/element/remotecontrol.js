import { pictureUrl } from "../source/pictures.js";

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
   * @param {import("./swingsplayer.js").SwingsPlayerElement} element
   * @param {import("./webplayer.js").WebPlayer} player
   * @param {AbortSignal} signal ends it
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
      for (const action of ACTIONS) {
        navigator.mediaSession.setActionHandler(action, (details) => this.#act(action, details));
      }
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

  /**
   * @param {(typeof ACTIONS)[number]} action
   * @param {MediaSessionActionDetails} details
   */
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
