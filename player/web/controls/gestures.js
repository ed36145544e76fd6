/** Gestures of fingers, mouse and wheel that move the camera. */

const TAP_MS = 250;
const TAP_PX = 12;
const PAUSE_MS = 300;
const APART_PX = 40;

/**
 * The part of a touch event that tap detection uses.
 * @typedef {object} Touched
 * @property {number} clientX @property {number} clientY
 * @property {number} timeStamp ms
 */

/** Detects double taps of one finger. */
export class Taps {
  /** @type {Touched | null} */
  #down = null;
  /** @type {Touched | null} the tap before */
  #last = null;

  /** Handles a finger that touches. @param {Touched} event @param {number} numFingers */
  down({ clientX, clientY, timeStamp }, numFingers) {
    this.#down = numFingers === 1 ? { clientX, clientY, timeStamp } : null;
  }

  /** Handles a lifted finger. @param {Touched} event @returns {boolean} whether that was a double tap */
  up({ clientX, clientY, timeStamp }) {
    const up = { clientX, clientY, timeStamp };
    const isTap = isNear(this.#down, up, TAP_MS, TAP_PX);
    const isDouble = isTap && isNear(this.#last, up, PAUSE_MS + TAP_MS, APART_PX);
    this.#last = isTap && !isDouble ? up : null;
    return isDouble;
  }
}

/** @param {Touched | null} first @param {Touched} second @param {number} withinMs @param {number} withinPx */
function isNear(first, second, withinMs, withinPx) {
  if (first === null || second.timeStamp - first.timeStamp > withinMs) return false;
  const awayPx = Math.hypot(second.clientX - first.clientX, second.clientY - first.clientY);
  return awayPx <= withinPx;
}

/** A one-finger move this far to the side is read as an attempt to look around. */
const LOOKS_PX = 16;
const HINT_PERIOD_MS = 1000;

/**
 * The part of a player that gestures use.
 * @typedef {object} Gestured
 * @property {import("../view/cameramotion.js").CameraMotion | null} motion
 * @property {import("../format/manifest.js").Camera | null} camera @property {number} pixelRatio
 * @property {() => void} moved
 */

/**
 * Moves the camera by pointers.
 *
 * Dragging with a mouse turns the camera around the scene; with the right button or shift it moves the
 * camera. In full screen, in a page that cannot scroll, and with the attribute `gestures="all"`, one finger
 * turns, two move, and pinching or the wheel zooms. Elsewhere the page must stay scrollable: one finger and
 * the wheel belong to the page, two fingers turn and zoom, three move, and the wheel zooms only with ctrl or
 * while the player has the focus. A gesture that is left to the page dispatches `gesturehint` (detail: what
 * to do instead), which leaves the shadow tree.
 *
 * A double tap, or a double click with alt, flies to the point of the scene at that place.
 * @param {HTMLElement} surface @param {Gestured} player
 * @param {(xPx: number, yPx: number) => void} focus flies to what shows at a place of the surface
 * @param {import("./texts.js").Translate} t @param {AbortSignal} signal ends the listening
 */
export function listenToGestures(surface, player, focus, t, signal) {
  /** @type {Map<number, { x: number, y: number, firstX: number }>} */
  const pointers = new Map();
  const taps = new Taps();
  /** @type {import("../view/cameramotion.js").Drag} the kind of the last drag */
  let dragged = "turn";
  let hintedMs = -Infinity;
  const focalPx = () => (player.camera?.fxPx ?? 500) / player.pixelRatio;

  const on = (
    /** @type {string} */ type,
    /** @type {(event: any) => void} */ action,
    /** @type {AddEventListenerOptions} */ options = {},
  ) => surface.addEventListener(type, action, { signal, ...options });

  const hint = (/** @type {string} */ detail, /** @type {number} */ atMs) => {
    if (atMs - hintedMs < HINT_PERIOD_MS) return;
    hintedMs = atMs;
    surface.dispatchEvent(
      new CustomEvent("gesturehint", { detail, bubbles: true, composed: true }),
    );
  };
  const focusAt = (/** @type {number} */ x, /** @type {number} */ y) => {
    const { left, top } = surface.getBoundingClientRect();
    focus(x - left, y - top);
  };

  let hasAll = false;
  const lookAtPage = () => {
    hasAll = ownsAllGestures(hostOf(surface));
    surface.style.touchAction = hasAll ? "none" : "pan-y";
  };
  // A page may begin to scroll once more of it is loaded.
  const resizing = new ResizeObserver(lookAtPage);
  for (const one of [surface, document.documentElement, document.body]) resizing.observe(one);
  const changing = new MutationObserver(lookAtPage);
  changing.observe(hostOf(surface), { attributeFilter: ["gestures", "class"] });
  signal.addEventListener("abort", () => {
    resizing.disconnect();
    changing.disconnect();
  });
  document.addEventListener("fullscreenchange", lookAtPage, { signal });
  globalThis.addEventListener("resize", lookAtPage, { signal });
  lookAtPage();

  on("pointerdown", (/** @type {PointerEvent} */ event) => {
    if (pointers.size === 0) lookAtPage();
    surface.setPointerCapture(event.pointerId);
    const { clientX: x, clientY: y } = event;
    pointers.set(event.pointerId, { x, y, firstX: x });
    player.motion?.grab();
    if (event.pointerType === "touch") taps.down(event, pointers.size);
  });
  on("pointermove", (/** @type {PointerEvent} */ event) => {
    const { motion } = player;
    const before = pointers.get(event.pointerId);
    if (motion === null || before === undefined) return;
    const isTouch = event.pointerType === "touch";
    const from = spreadOf([...pointers.values()]);
    pointers.set(event.pointerId, { ...before, x: event.clientX, y: event.clientY });
    if (isTouch && !hasAll && pointers.size === 1) {
      if (Math.abs(event.clientX - before.firstX) > LOOKS_PX)
        hint(t("Use two fingers to look around"), event.timeStamp);
      return;
    }
    const to = spreadOf([...pointers.values()]);
    const isPan = isTouch
      ? pointers.size === (hasAll ? 2 : 3)
      : (event.buttons & 2) !== 0 || event.shiftKey;
    dragged = isPan ? "pan" : "turn";
    const [rightPx, downPx] = [to.x - from.x, to.y - from.y];
    if (isPan) motion.dragPan(rightPx, downPx, focalPx(), event.timeStamp);
    else motion.dragTurn(rightPx, downPx, event.timeStamp);
    if (pointers.size > 1) motion.scale(from.spreadPx / to.spreadPx);
    player.moved();
  });
  for (const type of ["pointerup", "pointercancel", "lostpointercapture"]) {
    on(type, (/** @type {PointerEvent} */ event) => {
      if (!pointers.delete(event.pointerId)) return;
      if (pointers.size === 0) player.motion?.release(dragged, event.timeStamp);
      // The remaining fingers start a new drag, because their centre is elsewhere.
      else player.motion?.grab();
      player.moved();
      if (type === "pointerup" && event.pointerType === "touch" && taps.up(event))
        focusAt(event.clientX, event.clientY);
    });
  }
  // Two-finger gestures belong to the player even where one finger scrolls the page.
  for (const type of ["touchstart", "touchmove"]) {
    const take = (/** @type {TouchEvent} */ event) => {
      if (event.touches.length > 1 && event.cancelable) event.preventDefault();
    };
    on(type, take, { passive: false });
  }
  on("dblclick", (/** @type {MouseEvent} */ event) => {
    if (event.altKey) focusAt(event.clientX, event.clientY);
  });
  const turnWheel = (/** @type {WheelEvent} */ event) => {
    lookAtPage();
    if (!(event.ctrlKey || event.metaKey || hasAll || hasFocus(surface))) {
      hint(t("Use Ctrl and the wheel to come closer"), event.timeStamp);
      return;
    }
    event.preventDefault();
    const linesPx = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 33 : 1;
    player.motion?.approach((-event.deltaY * linesPx) / 100);
    player.moved();
  };
  on("wheel", turnWheel, { passive: false });
  on("contextmenu", (/** @type {Event} */ event) => event.preventDefault());
}

/** The centre of some places, and their mean distance from it. @param {{ x: number, y: number }[]} places */
function spreadOf(places) {
  const mean = (/** @type {number[]} */ values) =>
    values.reduce((sum, value) => sum + value, 0) / values.length;
  const x = mean(places.map((place) => place.x));
  const y = mean(places.map((place) => place.y));
  const spreadPx = mean(places.map((place) => Math.hypot(place.x - x, place.y - y)));
  return { x, y, spreadPx: Math.max(0.5, spreadPx) };
}

/**
 * Whether all gestures go to the player: in full screen, where the page asks for it, and where nothing
 * around the player scrolls. In a frame, the code cannot know whether the page around it scrolls.
 * @param {Element} host
 */
function ownsAllGestures(host) {
  if (host.matches(':fullscreen, .covering, [gestures="all"]')) return true;
  if (document.fullscreenElement?.contains(host)) return true;
  if (globalThis.parent !== globalThis.window) return false;
  if (document.documentElement.scrollHeight > globalThis.innerHeight + 1) return false;
  for (let around = host.parentElement; around !== null; around = around.parentElement) {
    const scrolls = /auto|scroll/.test(getComputedStyle(around).overflowY);
    if (scrolls && around.scrollHeight > around.clientHeight + 1) return false;
  }
  return true;
}

/** @param {HTMLElement} surface */
function hasFocus(surface) {
  return hostOf(surface).matches(":focus-within");
}

/** The element of the page that has `surface` in its shadow tree. @param {HTMLElement} surface */
function hostOf(surface) {
  const root = surface.getRootNode();
  return root instanceof ShadowRoot ? root.host : surface;
}
