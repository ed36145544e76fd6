/** The keys that move the camera and the playback; those of commands stand in commands.js. */

/** @typedef {import("../view/cameramotion.js").CameraMotion} CameraMotion */
/** @typedef {import("../view/cameramotion.js").Direction} Direction */

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
 * @param {Moved} player @returns {Record<string, () => void>}
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

/** Ends the push of a released key. @param {Moved} player @param {string} key name as in keyboard events */
export function liftCameraKey({ motion }, key) {
  if (motion === null) return;
  const name = key.toLowerCase();
  if (name in ARROWS) motion.letGo(ARROWS[name].push);
  // Without shift the letters turn the camera, and a keyup event of the shifted letter may not arrive.
  else if (name === "shift" && !motion.isFlying) motion.letGo();
}

export const RATES = [0.1, 0.25, 0.5, 1, 1.5, 2];

/** Step of the arrow keys, and of J and L; at most the given share of the clip's length. */
const STEP_S = 5;
const JUMP_S = 10;
const STEP_SHARE = 0.1;
const JUMP_SHARE = 0.2;

/**
 * @typedef {object} KeyAction
 * @property {string[]} keys names as in keyboard events, in lower case
 * @property {string} label @property {(key: string) => void} run
 */

/**
 * The keys of a player, in the order of the key list that users see. They match YouTube's keys where
 * YouTube has them.
 * @param {import("../element/swingsplayer.js").SwingsPlayerElement} element
 * @param {import("../element/webplayer.js").WebPlayer} player
 * @param {import("./commands.js").Command[]} commands @returns {KeyAction[]}
 */
export function keysOf(element, player, commands) {
  const lastFrame = () => player.numFrames - 1;
  const moveBy = (/** @type {number} */ frames) => {
    if (player.manifest === null) return;
    const frame = player.isSeeking ? player.soughtFrame : Math.max(0, player.shownFrame);
    player.seek(Math.max(0, Math.min(lastFrame(), frame + frames)));
  };
  const moveByS = (/** @type {number} */ seconds, /** @type {number} */ share) => {
    const { fps } = player.manifest ?? { fps: 30 };
    const most = player.live ? Infinity : share * player.numFrames;
    const frames = Math.max(1, Math.round(Math.min(Math.abs(seconds) * fps, most)));
    moveBy(Math.sign(seconds) * frames);
  };
  const step = (/** @type {number} */ frames) => {
    element.pause();
    moveBy(frames);
  };
  const seekTo = (/** @type {number} */ frame) => {
    if (player.manifest !== null) player.seek(frame);
  };
  const changeRate = (/** @type {number} */ by) => {
    const at = RATES.findIndex((rate) => rate >= element.playbackRate);
    element.playbackRate = RATES[Math.max(0, Math.min(RATES.length - 1, at + by))];
  };
  return [
    { keys: [" ", "k"], label: "Play or pause", run: () => element.togglePlaying() },
    { keys: ["arrowleft"], label: "Back 5 s", run: () => moveByS(-STEP_S, STEP_SHARE) },
    { keys: ["arrowright"], label: "Forward 5 s", run: () => moveByS(STEP_S, STEP_SHARE) },
    { keys: ["j"], label: "Back 10 s", run: () => moveByS(-JUMP_S, JUMP_SHARE) },
    { keys: ["l"], label: "Forward 10 s", run: () => moveByS(JUMP_S, JUMP_SHARE) },
    { keys: [","], label: "Previous frame", run: () => step(-1) },
    { keys: ["."], label: "Next frame", run: () => step(1) },
    { keys: ["home"], label: "To the start", run: () => seekTo(0) },
    {
      keys: ["end"],
      label: "To the end, or to the live edge",
      run: () => (player.live ? element.goLive() : seekTo(lastFrame())),
    },
    {
      keys: [..."0123456789"],
      label: "To a tenth of the clip",
      run: (digit) => seekTo(Math.floor((Number(digit) * player.numFrames) / 10)),
    },
    { keys: ["<"], label: "Slower", run: () => changeRate(-1) },
    { keys: [">"], label: "Faster", run: () => changeRate(1) },
    { keys: ["f"], label: "Full screen", run: () => element.toggleFullScreen() },
    {
      keys: ["shift+c"],
      label: "Copy a link to this moment and view",
      run: () => element.copyLink(),
    },
    ...commands
      .filter(({ key }) => key !== "")
      .map(({ key, label, run }) => ({ keys: [key], label, run })),
    ...cameraActions(player),
  ];
}

/** Descriptions of the camera's keys for the key list; keys with a similar effect share one line. */
const CAMERA_KEYS = /** @type {[string[], string][]} */ ([
  [["w", "a", "s", "d"], "Turn the camera; in flight, move it"],
  [["shift+w", "shift+a", "shift+s", "shift+d"], "Move the camera"],
  [["+", "="], "Move closer"],
  [["-"], "Move away"],
  [["n", "]"], "Next camera of the rig"],
  [["shift+n", "["], "Previous camera of the rig"],
  [["g"], "Start or end the flight"],
]);

/** @param {import("../element/webplayer.js").WebPlayer} player @returns {KeyAction[]} */
function cameraActions(player) {
  const actions = cameraKeys(player);
  return CAMERA_KEYS.map(([keys, label]) => ({
    keys: keys.filter((key) => Object.hasOwn(actions, key)),
    label,
    run: (/** @type {string} */ key) => actions[key](),
  })).filter(({ keys }) => keys.length > 0);
}

/**
 * Runs the action of a pressed key. A focused control keeps the keys that it uses itself.
 * @param {KeyAction[]} actions @param {KeyboardEvent} event @param {EventTarget} target the innermost one
 */
export function pressKey(actions, event, target) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const key = event.key.toLowerCase();
  if (key === " " && (target instanceof HTMLButtonElement || isSummary(target))) return;
  const names = event.shiftKey ? [`shift+${key}`, key] : [key];
  for (const name of names) {
    const action = actions.find(({ keys }) => keys.includes(name));
    if (action === undefined) continue;
    event.preventDefault();
    action.run(name);
    return;
  }
}

/** @param {EventTarget} target */
function isSummary(target) {
  return target instanceof HTMLElement && target.localName === "summary";
}
