/**
 * Measures `<swings-player>` from outside: imported before the player, it wraps what the player
 * calls. Counted is what the callbacks of the page's thread take, less the call that draws.
 */

import { Painter } from "/player/web/renderer/painter.js";
import { SplatRenderer } from "/player/web/renderer/splatrenderer.js";

/** Pictures that are not counted: programs are compiled, and all that shows is uploaded. */
const WARM_UP_PICTURES = 10;
const NUM_DRAWS = 5;
const TURN_PX = 2;

/**
 * A picture of a new order.
 * @typedef {object} Picture
 * @property {number} frame
 * @property {number} mainMs of callbacks since the one before, this one's with them
 * @property {number} uploadMs of that
 * @property {number} uploadBytes Gaussians and order
 * @property {number} sortMs
 * @property {number} decodeMs of the frame of which it was told last
 */

/** @type {Picture[]} */
const pictures = [];
let mainMs = 0;
let uploadMs = 0;
let uploadBytes = 0;
let isNew = false;
/** Nothing is drawn while it plays: a device without a GPU takes the cores that the workers need. */
let draws = false;
/** Calls that draw. */
let numDraws = 0;
/** @type {{ texture: WebGLTexture, words: Uint32Array } | null} of the mode that uploads all */
let whole = null;

const player = () => /** @type {any} */ (document.querySelector("swings-player")).player;

/** @param {() => void} callback */
function timed(callback) {
  const beganMs = performance.now();
  callback();
  mainMs += performance.now() - beganMs;
  if (!isNew) return;
  const { shownFrame, timings, state } = player();
  pictures.push({
    frame: shownFrame,
    mainMs,
    uploadMs,
    uploadBytes,
    sortMs: timings.sortMs,
    decodeMs: state.decodeMs,
  });
  isNew = false;
  mainMs = 0;
}

const requestFrame = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (callback) => requestFrame((ms) => timed(() => callback(ms)));
window.Worker = class extends Worker {
  set onmessage(/** @type {((event: MessageEvent) => void) | null} */ listener) {
    super.onmessage = (event) => timed(() => listener?.(event));
  }
};

const calls = /** @type {any} */ (WebGL2RenderingContext.prototype);
for (const name of ["bufferData", "bufferSubData", "texImage2D", "texSubImage2D"]) {
  const call = calls[name];
  calls[name] = function (/** @type {any[]} */ ...given) {
    for (const value of given) if (ArrayBuffer.isView(value)) uploadBytes += value.byteLength;
    return call.apply(this, given);
  };
}

const { draw } = Painter.prototype;
const { update } = SplatRenderer.prototype;

Painter.prototype.draw = function (...given) {
  numDraws += 1;
  if (!draws) return;
  const beganMs = performance.now();
  draw.apply(this, given);
  mainMs -= performance.now() - beganMs;
};

SplatRenderer.prototype.update = function (updates, order, frame) {
  const beganMs = performance.now();
  uploadBytes = 0;
  update.call(this, updates, order, frame);
  isNew = true;
  uploadMs = performance.now() - beganMs;
  if (whole === null) return;
  // Now as the paper's viewer does it. What it draws from has come the other way, and is not counted.
  mainMs -= uploadMs;
  const againMs = performance.now();
  uploadBytes = 0;
  uploadAll(this, whole, order);
  uploadMs = performance.now() - againMs;
};

/**
 * The texture of all Gaussians and the order, whatever is new.
 * @param {SplatRenderer} renderer
 * @param {{ texture: WebGLTexture, words: Uint32Array }} whole
 * @param {ArrayBufferView} order
 */
function uploadAll({ gl, order: buffer, resident }, { texture, words }, order) {
  gl.bindTexture(gl.TEXTURE_2D, texture);
  const [format, type] = [gl.RGBA_INTEGER, gl.UNSIGNED_INT];
  const { widthPx, heightPx } = resident;
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32UI, widthPx, heightPx, 0, format, type, words);
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, order, gl.STREAM_DRAW);
}

/** Milliseconds until the device has drawn what shows: the median of some. */
function finishedDrawMs() {
  const { gl, renderer, camera } = player();
  const pixel = new Uint8Array(4);
  const times = Array.from({ length: NUM_DRAWS }, () => {
    const beganMs = performance.now();
    renderer.draw(camera);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    return performance.now() - beganMs;
  });
  return times.sort((a, b) => a - b)[NUM_DRAWS >> 1];
}

/**
 * Plays the stream once, from its beginning.
 * @param {object} how
 * @param {number} how.rate
 * @param {boolean} how.uploadsAll on each sort
 * @param {boolean} how.isMoving whether the camera turns in every picture
 */
async function measure({ rate, uploadsAll, isMoving }) {
  const { gl, renderer, orbit } = player();
  if (uploadsAll) {
    const { widthPx, heightPx } = renderer.resident;
    whole = { texture: gl.createTexture(), words: new Uint32Array(4 * widthPx * heightPx) };
  }
  const turn = () => {
    orbit.dragTurn(TURN_PX, 0);
    player().moved();
    if (isMoving) requestFrame(turn);
  };
  if (isMoving) requestFrame(turn);
  const ended = new Promise((resolve) => player().addEventListener("ended", resolve));
  const beganMs = performance.now();
  player().setRate(rate);
  player().setPlaying(true);
  await ended;
  draws = true;
  const playedS = (performance.now() - beganMs) / 1000;
  isMoving = false;
  const info = /** @type {any} */ (gl.getExtension("WEBGL_debug_renderer_info"));
  return {
    pictures: pictures.slice(WARM_UP_PICTURES),
    picturesPerS: pictures.length / playedS,
    drawnPerS: numDraws / playedS,
    stalls: player().state.stalls,
    drawMs: uploadsAll ? 0 : finishedDrawMs(),
    device: gl.getParameter(info?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER),
  };
}

/**
 * Milliseconds until the device has drawn what shows, in turns as it is and half of the way from the frame
 * before; each number is the median of some.
 */
function measureBetween() {
  const { renderer } = player();
  /** @type {number[][]} */
  const times = [[], []];
  const inbetween = renderer.inbetween;
  for (let round = 0; round < NUM_DRAWS; round++) {
    for (const n of [0, 1]) {
      inbetween.share = n === 0 ? 1 : 0.5;
      times[n].push(finishedDrawMs());
    }
  }
  inbetween.share = 1;
  return times;
}

Object.assign(window, { measure, measureBetween });
