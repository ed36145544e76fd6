/**
 * Sorts, in a thread of its own: takes what is new from the thread that decodes, the camera from the
 * one that draws, and gives that one both at once: what is new, and the order in which to draw it.
 */

import { DepthOrder } from "../renderer/depthorder.js";
import { buffersOf } from "./packing.js";
import { scope } from "./workerscope.js";

/** @typedef {import("./playback.js").Shown & { numSlots: number, seeks: number }} Coming */

/** @type {DepthOrder | null} */
let order = null;
/** @type {Coming | null} the newest frame */
let newest = null;
/** @type {import("./packing.js").SplatUpdate[]} of what has not been handed on yet */
let updates = [];
/** @type {{ w2c: number[], nearM: number } | null} set while the thread that draws waits */
let wanted = null;
/** Whether something is new since the last order: a frame, or where the camera is. */
let isStale = false;

/** @param {Coming} shown */
function take(shown) {
  if (order === null || shown.isJoin) {
    order = new DepthOrder(shown.numSlots);
    updates = [];
  }
  for (const update of shown.updates) order.put(update.slots, update.means, update.starts);
  updates.push(...shown.updates);
  newest = shown;
  isStale = true;
}

/** Answers whoever waits, once there is something new. */
function sort() {
  if (wanted === null || order === null || newest === null || !isStale) return;
  const beganMs = performance.now();
  const slots = order.farFirst(newest.frame, wanted.w2c, wanted.nearM);
  const sortMs = performance.now() - beganMs;
  const handed = { frame: newest.frame, seeks: newest.seeks, updates, order: slots, sortMs };
  wanted = null;
  updates = [];
  isStale = false;
  scope.postMessage(handed, [
    /** @type {ArrayBuffer} */ (slots.buffer),
    ...handed.updates.flatMap(buffersOf),
  ]);
}

scope.onmessage = ({ data }) => {
  if (data.port) {
    const port = /** @type {MessagePort} */ (data.port);
    port.onmessage = (event) => {
      take(event.data);
      sort();
    };
    return;
  }
  wanted = data.view;
  isStale ||= data.isMoved;
  sort();
};
