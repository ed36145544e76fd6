/**
 * Keeps a scene, in a thread of its own: takes what is new from the thread that decodes, and gives it
 * to the page when that asks.
 */

import { scope } from "../playback/workerscope.js";
import { Scene } from "./scene.js";

/** @type {Scene | null} */
let scene = null;
/** Whether the page waits. */
let isWanted = false;
/** Whether something came since the page was last answered. */
let isStale = false;
/** Seeks that the play had taken in when it sent what is held here. */
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

scope.onmessage = ({ data }) => {
  if (data.port) {
    const { numGs, shDegree, lattices } = data.manifest;
    const kept = new Scene(numGs, shDegree, lattices);
    scene = kept;
    data.port.onmessage = (/** @type {MessageEvent} */ event) => {
      kept.put(event.data);
      seeks = event.data.seeks;
      isStale = true;
      answer();
    };
  }
  isWanted = true;
  answer();
};
