import { liftCameraKey } from "../view/camerakeys.js";
import { listenToGestures } from "./gestures.js";
import { Gyroscope } from "./gyroscope.js";

/** All by which a person moves the camera, besides keys that are pressed (view/camerakeys.js). */
export class CameraControls {
  /**
   * @param {HTMLElement} host
   * @param {HTMLCanvasElement} surface
   * @param {import("./webplayer.js").WebPlayer} player
   * @param {AbortSignal} signal ends it
   */
  constructor(host, surface, player, signal) {
    this.gyroscope = new Gyroscope(player);
    signal.addEventListener("abort", () => this.gyroscope.end());
    listenToGestures(surface, player, signal);
    host.addEventListener("keyup", ({ key }) => liftCameraKey(player, key), { signal });
    // The key may come up where we do not hear of it.
    const letGo = () => player.motion?.letGo();
    host.addEventListener("focusout", letGo, { signal });
    globalThis.addEventListener("blur", letGo, { signal });
  }
}
