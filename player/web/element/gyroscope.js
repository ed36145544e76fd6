import { deviceTurn, turnBetween } from "../view/deviceturn.js";

/** Turns the camera with the phone's orientation. Events: `change` (this.isOn). */
export class Gyroscope extends EventTarget {
  isOn = false;
  /** @type {import("../view/deviceturn.js").DeviceTurn | null} */
  #last = null;
  #listening = new AbortController();

  /** @param {import("../view/camerakeys.js").Moved} player */
  constructor(player) {
    super();
    this.player = player;
  }

  /**
   * Switches the gyroscope on or off. iOS asks for permission, which needs a recent user gesture.
   * @returns {Promise<boolean>} whether it is on; also false if the user or the page denies permission
   */
  async toggle() {
    if (this.isOn) {
      this.end();
      return false;
    }
    const events = /** @type {any} */ (globalThis).DeviceOrientationEvent;
    if (events === undefined) return false;
    try {
      const answer = (await events.requestPermission?.()) ?? "granted";
      if (answer !== "granted") return false;
    } catch (error) {
      console.warn("swings: the gyroscope needs a click to begin:", error);
      return false;
    }
    if (this.isOn) return true;
    this.#last = null;
    this.#listening = new AbortController();
    const turn = (/** @type {DeviceOrientationEvent} */ event) => this.#turn(event);
    globalThis.addEventListener("deviceorientation", turn, { signal: this.#listening.signal });
    this.#set(true);
    return true;
  }

  end() {
    this.#listening.abort();
    if (this.isOn) this.#set(false);
  }

  /** @param {DeviceOrientationEvent} event */
  #turn({ alpha, beta, gamma }) {
    if (alpha === null || beta === null || gamma === null) return;
    const turn = deviceTurn(alpha, beta, gamma);
    const last = this.#last;
    // A phone that lies flat has no heading; the last one is kept.
    this.#last = { ...turn, headingRad: turn.headingRad ?? last?.headingRad ?? null };
    const { motion } = this.player;
    if (last === null || motion === null || motion.isInFlight) return;
    motion.turn(...turnBetween(last, this.#last));
    this.player.moved();
  }

  /** @param {boolean} isOn */
  #set(isOn) {
    this.isOn = isOn;
    this.dispatchEvent(new Event("change"));
  }
}
