import { add, cross, dot, length, subtract, times, unit } from "../view/vectors.js";

/** @typedef {import("../view/vectors.js").Vector} Vector */
/** @typedef {import("../view/pose.js").Pose} Pose */

/** Where a headset's space has its y axis. */
const XR_UP = [0, 1, 0];

/**
 * Where the space of a headset lies in the world of a stream. Both are in metres: it is turned and
 * moved, and nothing is scaled. What is up for the headset is up in the scene.
 */
export class Placement {
  /**
   * @param {Pose} head in the headset's space; it comes to where `start` is, and faces the same way
   * @param {Pose} start in the world; it may look up or down, which is left to the head
   * @param {Vector} up of the scene, unit
   */
  constructor(head, start, up) {
    this.from = upright(head, XR_UP);
    this.to = upright(start, up);
    this.head = head.position;
    this.start = start.position;
  }

  /** A direction of the headset's space in the world. @param {Vector} a */
  direction(a) {
    return this.to.map((axis, i) => times(axis, dot(this.from[i], a))).reduce(add);
  }

  /** A pose of the headset's space in the world. @param {Pose} pose @returns {Pose} */
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
 * The axes right, up and ahead of someone who stands upright and faces as `pose` does.
 * @param {Pose} pose
 * @param {Vector} up unit
 * @returns {Vector[]}
 */
function upright({ forward, down }, up) {
  const level = (/** @type {Vector} */ a) => subtract(a, times(up, dot(a, up)));
  // Who looks straight down has the top of the head ahead, who looks straight up has it behind.
  const ahead = level(forward);
  const facing = length(ahead) > 0.1 ? ahead : level(times(down, Math.sign(dot(forward, up))));
  return [unit(cross(facing, up)), up, unit(facing)];
}
