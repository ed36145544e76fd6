import { framed } from "./framing.js";
import { rigUp, poseOf, worldToCamera } from "./pose.js";
import { sceneCentre } from "./scenecentre.js";
import { axesOf, normalised, quaternionOf } from "./turn.js";
import { add, length, subtract, times, turned } from "./vectors.js";

/** @typedef {import("./vectors.js").Vector} Vector */

/**
 * The part of a manifest that an orbit uses.
 * @typedef {object} OrbitScene
 * @property {import("../format/camera.js").Camera[]} cameras
 * @property {import("../format/camera.js").Camera} defaultCamera
 * @property {number[][]} bounds lower and upper corner, metres
 * @property {number[] | null} [focus] metres
 */

export const TURN_RAD_PER_PX = 0.005;
const LEAST_ZOOM = 0.02;
const MOST_ZOOM = 50;
/** Links may come from anywhere; larger numbers would leave floats no digits for the scene. */
const MOST_IN_TEXT = 1e6;

/**
 * The camera as turned, moved and zoomed around `centre`, starting from the pose `base`. At first both
 * are those of the stream; a flight changes them. This class knows nothing about time or about the
 * bounds of a scene; see cameramotion.js.
 */
export class Orbit {
  turnRad = 0;
  tiltRad = 0;
  /** Distance to the centre as a share of the base's. */
  zoom = 1;
  /** Right and down, in units of the distance to the centre. */
  pan = [0, 0];

  /** @param {OrbitScene} scene */
  constructor({ cameras, bounds, defaultCamera, focus }) {
    const poses = cameras.map(poseOf);
    /** The pose and centre that a reset returns to. */
    this.home = { pose: poseOf(defaultCamera), centre: sceneCentre(poses, bounds) };
    this.base = this.home.pose;
    this.centre = this.home.centre;
    this.up = rigUp(poses);
    /** The point that a picture too narrow for the whole view shows. */
    this.focus = focus ?? this.home.centre;
  }

  reset() {
    this.rebase(this.home.pose, this.home.centre);
  }

  /**
   * Puts the camera at `pose`; from then on it turns around `centre`.
   * @param {import("./pose.js").Pose} pose
   * @param {Vector} centre
   */
  rebase(pose, centre) {
    this.base = pose;
    this.centre = centre;
    this.turnRad = 0;
    this.tiltRad = 0;
    this.zoom = 1;
    this.pan = [0, 0];
  }

  /** Moves the camera and the point it turns around. @param {Vector} byM */
  shift(byM) {
    this.base = { ...this.base, position: add(this.base.position, byM) };
    this.centre = add(this.centre, byM);
  }

  /** @param {number} leftRad @param {number} upRad */
  turn(leftRad, upRad) {
    this.turnRad += leftRad;
    this.tiltRad = Math.min(Math.max(this.tiltRad + upRad, -Math.PI / 2), Math.PI / 2);
  }

  /**
   * @param {number} rightPx
   * @param {number} downPx
   * @param {number} focalPx
   */
  dragPan(rightPx, downPx, focalPx) {
    this.pan = [this.pan[0] + rightPx / focalPx, this.pan[1] + downPx / focalPx];
  }

  /** Multiplies the distance to the centre by `factor`. @param {number} factor */
  scale(factor) {
    this.zoom = Math.min(Math.max(this.zoom * factor, LEAST_ZOOM), MOST_ZOOM);
  }

  /** Distance to the centre in metres, without the pan. */
  get distanceM() {
    return length(subtract(this.base.position, this.centre)) * this.zoom;
  }

  /** @returns {import("./pose.js").Pose} */
  get pose() {
    const { centre, zoom } = this;
    let pose = carried(this.base, centre, this.up, this.turnRad);
    pose = carried(pose, centre, pose.right, this.tiltRad);
    const away = times(subtract(pose.position, centre), zoom);
    const aside = add(times(pose.right, this.pan[0]), times(pose.down, this.pan[1]));
    const position = subtract(add(centre, away), times(aside, length(away)));
    return { ...pose, position };
  }

  /**
   * The camera for a picture of the given size, with the lens of `start`.
   * @param {import("../format/camera.js").Camera} start
   * @param {number} widthPx
   * @param {number} heightPx
   */
  camera(start, widthPx, heightPx) {
    const lens = framed(start, this.focus, widthPx, heightPx);
    return { ...lens, w2c: worldToCamera(this.pose) };
  }

  /** Whether the camera has not moved since `rebase`. */
  get isAtBase() {
    const isTurned = this.turnRad !== 0 || this.tiltRad !== 0;
    return !isTurned && this.zoom === 1 && this.pan[0] === 0 && this.pan[1] === 0;
  }

  /**
   * The view as a short text, for links: turn, tilt, zoom, pan to the right and down. After a flight it
   * is the pose itself: position, quaternion, centre.
   */
  get text() {
    const { base, centre, home } = this;
    let numbers = [this.turnRad, this.tiltRad, this.zoom, ...this.pan];
    if (base !== home.pose || centre !== home.centre) {
      const { pose } = this;
      numbers = [...pose.position, ...quaternionOf(pose), ...centre];
    }
    return numbers.map((x) => Number(x.toFixed(4))).join(",");
  }

  /** Restores a view from its text; invalid text changes nothing. @param {string} text */
  set text(text) {
    const numbers = text.split(",").map(Number);
    if (!numbers.every((x) => Math.abs(x) <= MOST_IN_TEXT)) return;
    if (numbers.length === 5) {
      const [turnRad, tiltRad, zoom, right, down] = numbers;
      this.reset();
      this.turn(turnRad % (2 * Math.PI), tiltRad);
      this.scale(zoom);
      this.pan = [right, down];
    } else if (numbers.length === 10 && Math.hypot(...numbers.slice(3, 7)) > 0.5) {
      const axes = axesOf(normalised(numbers.slice(3, 7)));
      this.rebase({ position: numbers.slice(0, 3), ...axes }, numbers.slice(7));
    }
  }
}

/**
 * A pose rotated about an axis through `centre`.
 * @param {import("./pose.js").Pose} pose
 * @param {Vector} centre
 * @param {Vector} axis unit
 * @param {number} angleRad
 * @returns {import("./pose.js").Pose}
 */
function carried(pose, centre, axis, angleRad) {
  const turn = (/** @type {Vector} */ a) => turned(a, axis, angleRad);
  return {
    position: add(centre, turn(subtract(pose.position, centre))),
    right: turn(pose.right),
    down: turn(pose.down),
    forward: turn(pose.forward),
  };
}
