import { add, cross, dot, length, subtract, times, unit } from "../view/vectors.js";

/** @typedef {import("../view/vectors.js").Vector} Vector */
/** @typedef {import("../view/pose.js").Pose} Pose */

/** The up axis of a headset's space. */
const XR_UP = [0, 1, 0];

/**
 * The placement of a headset's space in the world of a stream. Both are in metres, so the space is
 * rotated and moved, but not scaled. Up in the headset's space is up in the scene.
 */
export class Placement {
  /**
   * @param {Pose} head in the headset's space; it is placed at `start`, facing the same way
   * @param {Pose} start in the world; its pitch is ignored, because the head determines it
   * @param {Vector} up of the scene, unit
   */
  constructor(head, start, up) {
    this.from = upright(head, XR_UP);
    this.to = upright(start, up);
    this.head = head.position;
    this.start = start.position;
  }

  /** Converts a direction from the headset's space to the world. @param {Vector} a */
  direction(a) {
    return this.to.map((axis, i) => times(axis, dot(this.from[i], a))).reduce(add);
  }

  /** Converts a pose from the headset's space to the world. @param {Pose} pose @returns {Pose} */
  pose({ position, right, down, forward }) {
    return {
      position: add(this.start, this.direction(subtract(position, this.head))),
      right: this.direction(right),
      down: this.direction(down),
      forward: this.direction(forward),
    };
  }
}

/**
 * The axes right, up and ahead of an upright viewer with the heading of `pose`.
 * @param {Pose} pose
 * @param {Vector} up unit
 * @returns {Vector[]}
 */
function upright({ forward, down }, up) {
  const level = (/** @type {Vector} */ a) => subtract(a, times(up, dot(a, up)));
  // Looking straight down, the top of the head points ahead; looking straight up, it points back.
  const ahead = level(forward);
  const facing = length(ahead) > 0.1 ? ahead : level(times(down, Math.sign(dot(forward, up))));
  return [unit(cross(facing, up)), up, unit(facing)];
}
