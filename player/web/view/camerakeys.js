/** The keys that move the camera. */

/** @typedef {import("./cameramotion.js").CameraMotion} CameraMotion */
/** @typedef {import("./cameramotion.js").Direction} Direction */

/**
 * The part of a player that the camera keys use.
 * @typedef {object} Moved
 * @property {CameraMotion | null} motion null until a stream is open
 * @property {() => void} moved requests a picture
 */

/** Turn per key press, equal to a drag of 30 pixels. */
const TURN_RAD = 0.15;

/** @type {Record<string, { push: Direction, turnRad: [number, number] }>} */
const ARROWS = {
  w: { push: "forward", turnRad: [0, -TURN_RAD] },
  s: { push: "back", turnRad: [0, TURN_RAD] },
  a: { push: "left", turnRad: [-TURN_RAD, 0] },
  d: { push: "right", turnRad: [TURN_RAD, 0] },
};

/**
 * The action of each key, by its name in lower case: "w", or "shift+w" with shift held. A pressed key
 * repeats; `liftCameraKey` must be called for released keys.
 * @param {Moved} player
 * @returns {Record<string, () => void>}
 */
export function cameraKeys(player) {
  const moving = (/** @type {(motion: CameraMotion) => void} */ action) => () => {
    if (player.motion === null) return;
    action(player.motion);
    player.moved();
  };
  const toCamera = (/** @type {number} */ by) =>
    moving((motion) => motion.flyToCamera(motion.cameraIndex + by));
  /** @type {Record<string, () => void>} */
  const keys = {
    "+": moving((motion) => motion.approach(1)),
    "=": moving((motion) => motion.approach(1)),
    "-": moving((motion) => motion.approach(-1)),
    r: moving((motion) => motion.reset()),
    g: moving((motion) => motion.fly(!motion.isFlying)),
    "[": toCamera(-1),
    "]": toCamera(1),
    // On many keyboards, typing a bracket needs a modifier key.
    n: toCamera(1),
    "shift+n": toCamera(-1),
  };
  for (const [key, { push, turnRad }] of Object.entries(ARROWS)) {
    keys[`shift+${key}`] = moving((motion) => motion.push(push));
    keys[key] = moving((motion) =>
      motion.isFlying ? motion.push(push) : motion.turn(turnRad[0], turnRad[1]),
    );
  }
  return keys;
}

/**
 * Ends the push of a released key.
 * @param {Moved} player
 * @param {string} key name as in keyboard events
 */
export function liftCameraKey({ motion }, key) {
  if (motion === null) return;
  const name = key.toLowerCase();
  if (name in ARROWS) motion.letGo(ARROWS[name].push);
  // Without shift the letters turn the camera, and a keyup event of the shifted letter may not arrive.
  else if (name === "shift" && !motion.isFlying) motion.letGo();
}
