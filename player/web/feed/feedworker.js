/**
 * Keeps a scene in a separate thread: receives changes from the decoding thread, and sends them to the
 * page on request.
 */

import { Scene } from "./scene.js";

/** @typedef {import("../playback/messages.js").FromKeeper} FromKeeper */
/** @typedef {import("../playback/messages.js").ShownFrame} ShownFrame */
/** @typedef {import("../playback/messages.js").ToKeeper} ToKeeper */

const scope = /** @type {import("../playback/messages.js").Channel<FromKeeper, ToKeeper>} */ (
  /** @type {unknown} */ (self)
);

/** @type {MessagePort | null} its frames wait for the scene */
let frames = null;
/** @type {Scene | null} */
let scene = null;
/** Whether the page waits for an answer. */
let isWanted = false;
/** Whether changes have arrived since the last answer. */
let isStale = false;
/** Number of seeks that the play had made when it sent the latest changes. */
let seeks = 0;

function answer() {
  if (scene === null || !isWanted || !isStale) return;
  isWanted = false;
  isStale = false;
  const change = scene.take();
  const arrays = [change.slots, ...Object.values(change.gaussians)];
  scope.postMessage(
    { ...change, seeks },
    arrays.map((array) => /** @type {ArrayBuffer} */ (array.buffer)),
  );
}

scope.onmessage = (/** @type {MessageEvent<ToKeeper>} */ { data }) => {
  if ("port" in data) frames = data.port;
  if ("manifest" in data && frames !== null) {
    const { numGs, shDegree, lattices } = data.manifest;
    const kept = new Scene(numGs, shDegree, lattices);
    scene = kept;
    frames.onmessage = (/** @type {MessageEvent<ShownFrame>} */ event) => {
      kept.put(event.data);
      seeks = event.data.seeks;
      isStale = true;
      answer();
    };
  }
  isWanted = true;
  answer();
};
