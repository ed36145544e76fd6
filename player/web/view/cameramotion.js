/** The camera's motion, from gestures and times to a pose. */

import { boundsOf, excessOf } from "./bounds.js";
import { between, eased, FLIGHT_S } from "./flight.js";
import { Orbit } from "./orbit.js";
import { poseOf } from "./pose.js";
import { add, cross, dot, length, subtract, times, unit } from "./vectors.js";

export const TURN_RAD_PER_PX = 0.005;

/** Moves the camera and the point it turns around. @param {Orbit} orbit @param {number[]} byM */
function shift(orbit, byM) {
  orbit.base = { ...orbit.base, position: add(orbit.base.position, byM) };
  orbit.centre = add(orbit.centre, byM);
}

/** @param {Orbit} orbit @param {number} rightPx @param {number} downPx @param {number} focalPx */
export function panBy(orbit, rightPx, downPx, focalPx) {
  orbit.pan = [orbit.pan[0] + rightPx / focalPx, orbit.pan[1] + downPx / focalPx];
}

/** Distance to the centre in metres, without the pan. @param {Orbit} orbit */
export function distanceOf({ base, centre, zoom }) {
  return length(subtract(base.position, centre)) * zoom;
}

/** Whether the camera has not moved since `rebase`. @param {Orbit} orbit */
function isAtBase({ turnRad, tiltRad, zoom, pan }) {
  return turnRad === 0 && tiltRad === 0 && zoom === 1 && pan[0] === 0 && pan[1] === 0;
}

/** Time before a pointer's release in which its motion counts. */
const WINDOW_MS = 80;
const MOST_SAMPLES = 32;

/** Measures the speed of a pointer when it is released. */
class Flick {
  /** @type {{ atMs: number, by: number[] }[]} */
  #samples = [];

  /** @param {number} atMs @param {number[]} by since the sample before */
  add(atMs, by) {
    this.#samples.push({ atMs, by });
    if (this.#samples.length > MOST_SAMPLES) this.#samples.shift();
  }

  /** Units per second; empty if the pointer has rested. @param {number} atMs @returns {number[]} */
  speed(atMs) {
    const recent = this.#samples.filter((sample) => atMs - sample.atMs <= WINDOW_MS);
    // The first sample's motion began before its time, so the sample only marks the start of the span.
    const [first, ...rest] = recent;
    if (rest.length === 0) return [];
    const spanS = Math.max(atMs - first.atMs, 8) / 1000;
    return first.by.map((_, i) => rest.reduce((sum, { by }) => sum + by[i], 0) / spanS);
  }
}

/** @typedef {import("./vectors.js").Vector} Vector */
/** @typedef {import("./pose.js").Pose} Pose */
/** @typedef {"turn" | "pan"} Drag */
/** @typedef {keyof typeof DIRECTIONS} Direction */

/** Time after which the speed of a released camera has fallen to 1/e. */
const DRIFT_S = 0.25;
/** The same, beyond the bounds. */
const STOP_S = 0.04;
/** Time after which the excess over the bounds has fallen to 1/e. */
const SPRING_S = 0.12;
/** Time constant with which a flying camera follows a key. */
const FOLLOW_S = 0.1;
/** Speed of a flying camera, per second, as a share of the rig's typical distance to the centre. */
const FLY_SHARE = 0.5;
/** At this excess over the bounds, a drag moves the camera a quarter as far: radians, log factors, shares. */
const SOFT = 0.2;
/** Excess, in the same units, that counts as within the bounds; up to twice this is removed in one step. */
const LEAST_EXCESS = 1e-4;
/** Below this speed, in the same units per second, a camera stops. */
const LEAST_SPEED = 2e-3;
/** Maximum time step of the motion, even if a picture took longer. */
const LONGEST_STEP_S = 0.25;
/** Time step of the first picture of a motion; the picture before it may be long ago. */
const FIRST_STEP_S = 1 / 60;
/** Factor for the distance to a tapped point. */
const FOCUS_SHARE = 0.7;
/** Unit vectors: right, down, forward. */
const DIRECTIONS = {
  right: [1, 0, 0],
  left: [-1, 0, 0],
  forward: [0, 0, 1],
  back: [0, 0, -1],
};

/**
 * The camera's motion: it takes gestures and times, and gives a pose. It uses no clock and no page.
 *
 * After a drag, the camera drifts to a stop; a camera beyond the scene's bounds springs back; flights
 * lead to other places, and any other motion ends them.
 */
export class CameraMotion {
  /** @type {{ from: import("./flight.js").Place, to: import("./flight.js").Place, elapsedS: number, base: Pose } | null} */
  #flight = null;
  /** @type {{ what: Drag, speed: number[] } | null} per second; turn: radians; pan: shares of the distance */
  #drift = null;
  #flick = new Flick();
  #isHeld = false;
  #lastMs = -Infinity;
  #wasMoving = false;
  /** @type {Set<Direction>} directions of the keys that are held down */
  #pushes = new Set();
  /** Metres per second, in the world frame. */
  #velocity = [0, 0, 0];
  #isFlying = false;
  /** Index of the rig's camera that the last flight led to. */
  cameraIndex;

  /**
   * @param {import("./orbit.js").OrbitScene} scene
   * @param {() => boolean} isReduced whether the user prefers reduced motion; then every move is immediate
   * @param {Orbit} orbit the camera
   */
  constructor(scene, isReduced = () => false, orbit = new Orbit(scene)) {
    /** @type {Orbit} */ this.orbit = orbit;
    this.bounds = boundsOf(scene);
    /** @type {() => boolean} */ this.isReduced = isReduced;
    this.cameras = scene.cameras;
    this.homeIndex = scene.cameras.findIndex(({ name }) => name === scene.defaultCamera.name);
    this.cameraIndex = this.homeIndex;
  }

  /** Whether fly mode is on: drags turn the camera on the spot, and keys move it. */
  get isFlying() {
    return this.#isFlying;
  }

  /** Whether the camera flies to another place. */
  get isInFlight() {
    return this.#flight !== null;
  }

  /** Whether the next step may move the camera. */
  get isMoving() {
    const { excess } = this;
    return (
      this.#flight !== null ||
      this.#drift !== null ||
      this.#pushes.size > 0 ||
      length(this.#velocity) > 0 ||
      (!this.#isHeld && !this.#isWithin(excess))
    );
  }

  /** The amount by which the camera exceeds the scene's bounds. */
  get excess() {
    const { orbit, bounds } = this;
    return excessOf(bounds, orbit.pose, this.#isFlying ? null : distanceOf(orbit));
  }

  /** Stops the camera at the start of a drag. */
  grab() {
    this.#isHeld = true;
    this.#stop();
    this.#flick = new Flick();
  }

  /** Lets the camera drift after a drag. @param {Drag} what kind of the last drag @param {number} atMs */
  release(what, atMs) {
    if (!this.#isHeld) return;
    this.#isHeld = false;
    const speed = this.#flick.speed(atMs);
    if (this.isReduced() || !speed.some((x) => Math.abs(x) > LEAST_SPEED)) return;
    this.#drift = { what, speed };
  }

  /** @param {number} rightPx @param {number} downPx @param {number} atMs */
  dragTurn(rightPx, downPx, atMs) {
    // The near objects follow the pointer: the front of the scene, or in fly mode the surroundings.
    const radPerPx = this.#isFlying ? TURN_RAD_PER_PX / 2 : -TURN_RAD_PER_PX;
    const by = [rightPx * radPerPx, downPx * radPerPx];
    this.#flick.add(atMs, by);
    this.turn(by[0], by[1]);
  }

  /** @param {number} rightPx @param {number} downPx @param {number} focalPx @param {number} atMs */
  dragPan(rightPx, downPx, focalPx, atMs) {
    const by = [rightPx / focalPx, downPx / focalPx];
    this.#flick.add(atMs, by);
    this.#pan(by[0], by[1]);
  }

  /** Turns around the centre; in fly mode, on the spot. @param {number} leftRad @param {number} upRad */
  turn(leftRad, upRad) {
    this.#flight = null;
    const { orbit, excess } = this;
    if (this.#isFlying) orbit.rebase(orbit.pose, orbit.pose.position);
    const left = resisted(leftRad, excess.headingRad);
    orbit.turn(left, resisted(upRad, -excess.pitchRad));
  }

  /** @param {number} right @param {number} down in units of the distance to the centre */
  #pan(right, down) {
    this.#flight = null;
    const { orbit, excess } = this;
    const distanceM = this.#isFlying ? this.bounds.scaleM : distanceOf(orbit);
    if (distanceM <= 0) return;
    const { right: rightAxis, down: downAxis } = orbit.pose;
    const by = times(add(times(rightAxis, -right), times(downAxis, -down)), distanceM);
    const outM = dot(by, excess.offM) > 0 ? length(excess.offM) : 0;
    const share = resisted(1, outM / distanceM);
    if (this.#isFlying) shift(orbit, times(by, share));
    else panBy(orbit, right * share, down * share, 1);
  }

  /** Multiplies the distance to the centre by `factor`. @param {number} factor */
  scale(factor) {
    if (!(factor > 0)) return;
    this.#flight = null;
    const { orbit, excess } = this;
    if (this.#isFlying) {
      shift(orbit, times(orbit.pose.forward, -Math.log(factor) * this.bounds.scaleM));
    } else orbit.scale(Math.exp(resisted(Math.log(factor), excess.logDistance)));
  }

  /** Zooms in by a number of wheel steps. @param {number} steps */
  approach(steps) {
    this.scale(0.9 ** steps);
  }

  /** Flies back to the first view. */
  reset() {
    this.fly(false);
    this.cameraIndex = this.homeIndex;
    this.flyTo(this.orbit.home);
  }

  /** Flies to a camera of the rig; the index wraps around. @param {number} index */
  flyToCamera(index) {
    const count = this.cameras.length;
    this.cameraIndex = ((index % count) + count) % count;
    this.fly(false);
    if (this.cameraIndex === this.homeIndex) this.flyTo(this.orbit.home);
    else
      this.flyTo({ pose: poseOf(this.cameras[this.cameraIndex]), centre: this.orbit.home.centre });
  }

  /**
   * Flies towards a point, which moves to the picture's centre and becomes the point to turn around.
   * @param {Vector} point in the world frame, metres
   */
  focusOn(point) {
    this.fly(false);
    const { pose } = this.orbit;
    const towards = subtract(point, pose.position);
    const forward = unit(towards);
    const aside = cross(forward, this.bounds.up);
    if (!(length(towards) > 0) || length(aside) < 1e-3) return;
    const right = unit(aside);
    const centre = this.#nearCentre(pose.position, point);
    const awayM = length(subtract(centre, pose.position));
    const leastM = Math.min(awayM, this.bounds.distanceM[0]);
    const position = subtract(centre, times(forward, Math.max(FOCUS_SHARE * awayM, leastM)));
    this.flyTo({ pose: { position, right, down: cross(forward, right), forward }, centre });
  }

  /**
   * The farthest point on the way to `to` that lies within `focusM` of the scene's centre.
   * @param {Vector} from @param {Vector} to
   */
  #nearCentre(from, to) {
    const { centre, focusM } = this.bounds;
    const way = subtract(to, from);
    const start = subtract(from, centre);
    const [a, b] = [dot(way, way), dot(start, way)];
    const root = b * b - a * (dot(start, start) - focusM * focusM);
    const share = root > 0 ? (Math.sqrt(root) - b) / a : -b / a;
    return add(from, times(way, share > 0 ? Math.min(1, share) : 1));
  }

  /** @param {import("./flight.js").Place} to */
  flyTo(to) {
    this.#stop();
    const { orbit } = this;
    if (this.isReduced()) {
      orbit.rebase(to.pose, to.centre);
      return;
    }
    const from = { pose: orbit.pose, centre: orbit.centre };
    orbit.rebase(from.pose, from.centre);
    this.#flight = { from, to, elapsedS: 0, base: orbit.base };
  }

  /** Begins or ends fly mode. @param {boolean} isFlying */
  fly(isFlying) {
    if (isFlying === this.#isFlying) return;
    this.#stop();
    this.letGo();
    const { orbit, bounds } = this;
    const { pose } = orbit;
    if (isFlying) orbit.rebase(pose, pose.position);
    else {
      const aheadM = dot(subtract(bounds.centre, pose.position), pose.forward);
      const distanceM = Math.min(Math.max(aheadM, bounds.scaleM / 4), bounds.distanceM[1]);
      const ahead = add(pose.position, times(pose.forward, distanceM));
      orbit.rebase(pose, this.#nearCentre(pose.position, ahead));
    }
    this.#isFlying = isFlying;
  }

  /** Pushes the camera in a direction until `letGo`. @param {Direction} direction */
  push(direction) {
    this.#flight = null;
    this.#drift = null;
    this.#pushes.add(direction);
  }

  /** Ends a push, or all of them. @param {Direction | null} direction */
  letGo(direction = null) {
    if (direction === null) this.#pushes.clear();
    else this.#pushes.delete(direction);
  }

  /**
   * Advances the motion to a time.
   * @param {number} nowMs @returns {boolean} whether the camera has moved, and may move further
   */
  step(nowMs) {
    const sinceS = (nowMs - this.#lastMs) / 1000;
    this.#lastMs = nowMs;
    const stepS = Math.min(this.#wasMoving ? Math.max(sinceS, 0) : FIRST_STEP_S, LONGEST_STEP_S);
    const flew = this.#stepFlight(stepS);
    const drifted = this.#stepDrift(stepS);
    const pushed = this.#stepPush(stepS);
    const settled = !this.#isHeld && this.#flight === null && this.#settle(stepS);
    this.#wasMoving = flew || drifted || pushed || settled;
    return this.#wasMoving;
  }

  /** @param {number} stepS */
  #stepFlight(stepS) {
    const flight = this.#flight;
    if (flight === null) return false;
    const { orbit } = this;
    if (orbit.base !== flight.base || !isAtBase(orbit)) {
      this.#flight = null; // something else has moved the camera
      return false;
    }
    flight.elapsedS += stepS;
    const share = Math.min(1, flight.elapsedS / FLIGHT_S);
    const { pose, centre } = between(flight.from, flight.to, eased(share));
    orbit.rebase(pose, centre);
    flight.base = pose;
    if (share === 1) this.#flight = null;
    return true;
  }

  /** @param {number} stepS */
  #stepDrift(stepS) {
    const drift = this.#drift;
    if (drift === null) return false;
    const decayS = this.#isWithin(this.excess) ? DRIFT_S : STOP_S;
    // The integral of an exponentially falling speed, so the way does not depend on the step length.
    const wayS = DRIFT_S * (1 - Math.exp(-stepS / DRIFT_S));
    const [x, y] = drift.speed.map((speed) => speed * wayS);
    if (drift.what === "turn") this.turn(x, y);
    else this.#pan(x, y);
    drift.speed = drift.speed.map((speed) => speed * Math.exp(-stepS / decayS));
    if (drift.speed.every((speed) => Math.abs(speed) < LEAST_SPEED)) this.#drift = null;
    return true;
  }

  /** @param {number} stepS */
  #stepPush(stepS) {
    if (this.#pushes.size === 0 && length(this.#velocity) === 0) return false;
    const { orbit, bounds } = this;
    const { right, down, forward } = orbit.pose;
    const [x, y, z] = [...this.#pushes].map((name) => DIRECTIONS[name]).reduce(add, [0, 0, 0]);
    const direction = add(add(times(right, x), times(down, y)), times(forward, z));
    const wanted = times(direction, FLY_SHARE * bounds.scaleM);
    const stay = this.isReduced() ? 0 : Math.exp(-stepS / FOLLOW_S);
    const last = this.#velocity;
    this.#velocity = add(times(last, stay), times(wanted, 1 - stay));
    const isSlow = length(this.#velocity) < LEAST_SPEED * bounds.scaleM;
    if (isSlow && this.#pushes.size === 0) this.#velocity = [0, 0, 0];
    shift(orbit, times(add(last, this.#velocity), stepS / 2));
    return true;
  }

  /** Brings the camera nearer to the bounds. @param {number} stepS */
  #settle(stepS) {
    const { orbit, bounds, excess } = this;
    if (this.#isWithin(excess)) return false;
    const before = orbit.pose;
    const isLast = this.isReduced() || this.#isWithin(excess, 2);
    const share = isLast ? 1 : 1 - Math.exp(-stepS / SPRING_S);
    orbit.turn(-share * excess.headingRad, share * excess.pitchRad);
    if (excess.logDistance !== 0) {
      const { zoom } = orbit;
      orbit.scale(Math.exp(-share * excess.logDistance));
      // A link may have put the base so far away that the zoom reaches its limit.
      if (orbit.zoom === zoom) orbit.rebase(orbit.pose, orbit.centre);
    }
    this.#bringBack(times(excess.offM, -share));
    const after = orbit.pose;
    const movedM = length(subtract(after.position, before.position));
    // If no move brings the camera nearer, it stays.
    return movedM > 1e-6 * bounds.scaleM || length(subtract(after.forward, before.forward)) > 1e-6;
  }

  /** @param {Vector} byM */
  #bringBack(byM) {
    const { orbit } = this;
    const { pose } = orbit;
    const distanceM = distanceOf(orbit);
    if (this.#isFlying || orbit.centre !== orbit.home.centre || distanceM <= 0) {
      if (length(byM) > 0) shift(orbit, byM);
      return;
    }
    // A pan, so that the camera still turns around the scene's centre.
    panBy(orbit, -dot(byM, pose.right), -dot(byM, pose.down), distanceM);
  }

  /** @param {import("./bounds.js").Excess} excess @param {number} factor */
  #isWithin({ logDistance, pitchRad, headingRad, offM }, factor = 1) {
    const shares = [logDistance, pitchRad, headingRad, length(offM) / this.bounds.scaleM];
    return shares.every((share) => Math.abs(share) <= factor * LEAST_EXCESS);
  }

  #stop() {
    this.#flight = null;
    this.#drift = null;
    this.#velocity = [0, 0, 0];
  }
}

/**
 * A motion, damped the more the farther it is beyond the bounds.
 * @param {number} by @param {number} excess in the direction of `by`
 */
function resisted(by, excess) {
  return by * excess <= 0 ? by : by / (1 + Math.abs(excess) / SOFT) ** 2;
}
