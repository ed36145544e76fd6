import { liftCameraKey } from "../view/camerakeys.js";
import { listenToGestures } from "./gestures.js";
import { Gyroscope } from "./gyroscope.js";

/** All controls of the camera except key presses (view/camerakeys.js): gestures, gyroscope, key releases. */
export class CameraControls {
  /**
   * @param {HTMLElement} host
   * @param {HTMLCanvasElement} surface
   * @param {import("./webplayer.js").WebPlayer} player
   * @param {AbortSignal} signal ends the listening
   */
  constructor(host, surface, player, signal) {
    this.gyroscope = new Gyroscope(player);
    signal.addEventListener("abort", () => this.gyroscope.end());
    listenToGestures(surface, player, signal);
    host.addEventListener("keyup", ({ key }) => liftCameraKey(player, key), { signal });
    // After a loss of focus, the keyup event may go elsewhere.
    const letGo = () => player.motion?.letGo();
    host.addEventListener("focusout", letGo, { signal });
    globalThis.addEventListener("blur", letGo, { signal });
  }
}
