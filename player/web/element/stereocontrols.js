import { hasHeadset, HeadsetError } from "../stereo/headset.js";

/** Side by side and VR. */
export class StereoControls {
  #isStarting = false;

  /**
   * @param {import("./webplayer.js").WebPlayer} player
   * @param {(message: string) => void} hint shows a message
   */
  constructor(player, hint) {
    this.player = player;
    this.hint = hint;
  }

  get isSideBySide() {
    return this.player.isSideBySide;
  }

  /** Whether a headset shows the scene. */
  get isWorn() {
    return this.player.headset !== null;
  }

  /**
   * Reports whether there is a headset, now and when that changes.
   * @param {(isThere: boolean) => void} report
   * @param {AbortSignal} signal ends the listening
   */
  watch(report, signal) {
    const look = async () => report(await hasHeadset());
    navigator.xr?.addEventListener("devicechange", look, { signal });
    look();
  }

  toggleSideBySide() {
    this.player.setSideBySide(!this.player.isSideBySide);
  }

  async toggleHeadset() {
    const { player } = this;
    if (player.headset !== null) {
      player.headset.end();
      return;
    }
    if (this.#isStarting) return;
    this.#isStarting = true;
    try {
      await player.enterHeadset();
    } catch (error) {
      if (!(error instanceof HeadsetError)) throw error;
      this.hint(error.message);
    } finally {
      this.#isStarting = false;
    }
  }
}
