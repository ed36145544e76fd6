/** Ways to move the camera, such as turning the phone; places of the canvas, and what shows there. */

import { prefersStill } from "../element/nodes.js";
import { depthAt } from "../renderer/depthquery.js";
import { CameraMotion } from "../view/cameramotion.js";
import { poseOf } from "../view/pose.js";
import { add, times } from "../view/vectors.js";
import { listenToGestures } from "./gestures.js";
import { liftCameraKey } from "./keys.js";

const RAD_PER_DEG = Math.PI / 180;
/** Below this horizontal part, the phone points almost straight up or down and has no heading. */
const LEAST_LEVEL = 0.2;

/** @typedef {{ requestPermission?: () => Promise<string> }} Asking only iOS does */

/**
 * The direction in which the back of a device points.
 * @typedef {object} DeviceTurn
 * @property {number | null} headingRad to the left, from an arbitrary zero; null: straight up or down
 * @property {number} pitchRad upwards
 */

/**
 * The turn of a DeviceOrientationEvent. All angles in degrees, in the order Z, X', Y''.
 * @param {number} alpha @param {number} beta @param {number} gamma @returns {DeviceTurn}
 */
export function deviceTurn(alpha, beta, gamma) {
  const [a, b, c] = [alpha, beta, gamma].map((angle) => angle * RAD_PER_DEG);
  // The device's -z in axes east, north and up: the last column of Rz(a) Rx(b) Ry(c), negated.
  const east = -(Math.cos(a) * Math.sin(c) + Math.sin(a) * Math.sin(b) * Math.cos(c));
  const north = -(Math.sin(a) * Math.sin(c) - Math.cos(a) * Math.sin(b) * Math.cos(c));
  const up = -Math.cos(b) * Math.cos(c);
  return {
    headingRad: Math.hypot(east, north) < LEAST_LEVEL ? null : Math.atan2(-east, north),
    pitchRad: Math.asin(Math.min(Math.max(up, -1), 1)),
  };
}

/**
 * The camera turn that corresponds to a device's motion between two turns: left and up, radians.
 * @param {DeviceTurn} from @param {DeviceTurn} to @returns {[number, number]}
 */
export function turnBetween(from, to) {
  const left =
    from.headingRad === null || to.headingRad === null ? 0 : to.headingRad - from.headingRad;
  return [Math.atan2(Math.sin(left), Math.cos(left)), to.pitchRad - from.pitchRad];
}

/** Turns the camera with the phone's orientation. Events: `change` (this.isOn). */
class Gyroscope extends EventTarget {
  isOn = false;
  /** @type {DeviceTurn | null} */
  #last = null;
  #listening = new AbortController();

  /** @param {import("./keys.js").Moved} player */
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
    const events = /** @type {Asking | undefined} */ (globalThis.DeviceOrientationEvent);
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

/**
 * The world point that a pixel shows.
 * @param {import("../format/manifest.js").Camera} camera @param {number} xPx from the left
 * @param {number} yPx from the top @param {number} depthM forward from the camera @returns {import("../view/vectors.js").Vector}
 */
function pointAt(camera, xPx, yPx, depthM) {
  const { position, right, down, forward } = poseOf(camera);
  const asideM = (depthM * (xPx - camera.cxPx)) / camera.fxPx;
  const belowM = (depthM * (yPx - camera.cyPx)) / camera.fyPx;
  return [times(right, asideM), times(down, belowM), times(forward, depthM)].reduce(add, position);
}

/**
 * The point of the scene at a place of the canvas; null where the picture is empty.
 * @param {import("../element/sceneview.js").SceneView} view @param {number} xPx from the left, in CSS pixels
 * @param {number} yPx from the top
 */
export function scenePointAt({ camera, painter, size, isEmpty }, xPx, yPx) {
  if (camera === null || isEmpty) return null;
  const x = (xPx * size.pixelRatio) % camera.widthPx; // side by side there are two pictures
  const y = yPx * size.pixelRatio;
  const { renderer } = painter;
  const depthM = renderer && depthAt(renderer, camera, x, y);
  return depthM === null ? null : pointAt(camera, x, y, depthM);
}

/**
 * Flies to the point of the scene at a place of the canvas, if there is one, and turns around it from then on.
 * @param {import("../element/webplayer.js").WebPlayer} player
 * @param {number} xPx from the left, in CSS pixels @param {number} yPx from the top
 */
function focusAt(player, xPx, yPx) {
  const point = scenePointAt(player.view, xPx, yPx);
  if (point === null) return;
  player.motion?.focusOn(point);
  player.moved();
}

/** All controls of the camera except key presses (keys.js): its motion, gestures, gyroscope, key releases. */
export class CameraControls {
  /**
   * @param {HTMLElement} host @param {HTMLCanvasElement} surface
   * @param {import("../element/webplayer.js").WebPlayer} player @param {import("./texts.js").Translate} t
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
