import { eyesAt } from "../stereo/eyes.js";

/** The commands for side-by-side pictures and VR. */
export class StereoControls {
  #isStarting = false;
  /** Whether there is a headset that this page may use. */
  isThere = false;

  /**
   * @param {import("../element/webplayer.js").WebPlayer} player
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
   * @param {(isThere: boolean) => void} report @param {AbortSignal} signal ends the listening
   */
  watch(report, signal) {
    const look = async () => {
      this.isThere = await hasHeadset();
      report(this.isThere);
      if (!this.isThere) return;
      // A session has to begin within the click that requests it, so the code is loaded in advance.
      await import("../stereo/headset.js").catch((/** @type {unknown} */ error) =>
        console.warn("swings: the code for headsets could not be loaded:", error),
      );
    };
    navigator.xr?.addEventListener("devicechange", look, { signal });
    look();
  }

  toggleSideBySide() {
    this.player.setSideBySide(this.player.isSideBySide ? null : eyesAt);
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
      const { HeadsetError } = await import("../stereo/headset.js");
      if (!(error instanceof HeadsetError)) throw error;
      this.hint(error.message);
    } finally {
      this.#isStarting = false;
    }
  }
}

/** Whether there is a headset that this page may use. */
async function hasHeadset() {
  try {
    return (await navigator.xr?.isSessionSupported("immersive-vr")) ?? false;
  } catch (error) {
    // A frame whose page does not allow WebXR is no failure.
    console.info("swings: this page may not use a headset:", error);
    return false;
  }
}
