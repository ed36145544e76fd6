import { hasHeadset, HeadsetError } from "../stereo/headset.js";

/** The buttons of side by side and of VR. The second one shows where there is a headset. */
export class StereoControls {
  #isStarting = false;

  /**
   * @param {ShadowRoot} root
   * @param {import("./webplayer.js").WebPlayer} player
   * @param {(message: string) => void} hint says something to the person
   * @param {AbortSignal} signal ends the listening
   */
  constructor(root, player, hint, signal) {
    this.player = player;
    this.hint = hint;
    const part = (/** @type {string} */ selector) =>
      /** @type {HTMLButtonElement} */ (root.querySelector(selector));
    this.sideBySide = part(".side-by-side");
    this.headset = part(".headset");
    this.sideBySide.addEventListener("click", () => this.toggleSideBySide(), { signal });
    this.headset.addEventListener("click", () => this.toggleHeadset(), { signal });
    const press = () => this.headset.setAttribute("aria-pressed", String(player.headset !== null));
    player.addEventListener("headset", press, { signal });
    const look = async () => {
      this.headset.hidden = !(await hasHeadset());
    };
    navigator.xr?.addEventListener("devicechange", look, { signal });
    look();
  }

  toggleSideBySide() {
    const { player } = this;
    player.setSideBySide(!player.isSideBySide);
    this.sideBySide.setAttribute("aria-pressed", String(player.isSideBySide));
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
