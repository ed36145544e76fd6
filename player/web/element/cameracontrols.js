import { liftCameraKey } from "../view/camerakeys.js";
import { CameraMotion } from "../view/cameramotion.js";
import { listenToGestures } from "./gestures.js";
import { Gyroscope } from "./gyroscope.js";
import { prefersStill } from "./motion.js";
import { focusAt } from "./pointing.js";

/** All controls of the camera except key presses (view/camerakeys.js): its motion, gestures, gyroscope, key releases. */
export class CameraControls {
  /**
   * @param {HTMLElement} host
   * @param {HTMLCanvasElement} surface
   * @param {import("./webplayer.js").WebPlayer} player
   * @param {import("./texts.js").Translate} t
   * @param {AbortSignal} signal ends the listening
   */
  constructor(host, surface, player, t, signal) {
    player.view.steer((scene, orbit) => new CameraMotion(scene, prefersStill, orbit));
    this.gyroscope = new Gyroscope(player);
    signal.addEventListener("abort", () => this.gyroscope.end());
    const focus = (/** @type {number} */ xPx, /** @type {number} */ yPx) =>
      focusAt(player, xPx, yPx);
    listenToGestures(surface, player, focus, t, signal);
    host.addEventListener("keyup", ({ key }) => liftCameraKey(player, key), { signal });
    // After a loss of focus, the keyup event may go elsewhere.
    const letGo = () => player.motion?.letGo();
    host.addEventListener("focusout", letGo, { signal });
    globalThis.addEventListener("blur", letGo, { signal });
  }
}
