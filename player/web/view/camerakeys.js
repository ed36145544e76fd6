/** The keys that move the camera. */

/** @typedef {import("./cameramotion.js").CameraMotion} CameraMotion */
/** @typedef {import("./cameramotion.js").Direction} Direction */

/**
 * What keys need of a player.
 * @typedef {object} Moved
 * @property {CameraMotion | null} motion null until a stream is open
 * @property {() => void} moved asks for a picture
 */

/** One press turns the camera by as much as a drag of 30 pixels. */
const TURN_RAD = 0.15;

/** @type {Record<string, { push: Direction, turnRad: [number, number] }>} */
const ARROWS = {
  w: { push: "forward", turnRad: [0, -TURN_RAD] },
  s: { push: "back", turnRad: [0, TURN_RAD] },
  a: { push: "left", turnRad: [-TURN_RAD, 0] },
  d: { push: "right", turnRad: [TURN_RAD, 0] },
};

/**
 * What each key does, by its name in lower case: "w", or "shift+w" with that key held. A pressed key
 * repeats; `liftCameraKey` must hear of keys that come up.
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
    // Many keyboards have no brackets without a further key.
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
 * A key has come up: the camera is no longer pushed by it.
 * @param {Moved} player
 * @param {string} key as events have it
 */
export function liftCameraKey({ motion }, key) {
  if (motion === null) return;
  const name = key.toLowerCase();
  if (name in ARROWS) motion.letGo(ARROWS[name].push);
  // Without shift the letters turn, and their own events may not come.
  else if (name === "shift" && !motion.isFlying) motion.letGo();
}
