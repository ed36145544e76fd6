/**
 * Sorts, in a thread of its own: takes what is new from the thread that decodes, the camera from the
 * one that draws, and gives that one both at once: what is new, and the order in which to draw it.
 */

import { DepthOrder } from "../renderer/depthorder.js";
import { buffersOf } from "./packing.js";
import { scope } from "./workerscope.js";

/** @type {DepthOrder | null} */
let order = null;
/** @type {{ w2c: number[], nearM: number } | null} */
let view = null;
/** @type {import("./playback.js").Shown | null} what has not been drawn yet */
let coming = null;
let frame = 0;
let generation = 0;
/** Whether the thread that draws waits for an order; one is underway at most. */
let isWanted = false;

/** Takes in a frame. @param {import("./playback.js").Shown & { numSlots: number, generation: number }} shown */
function take(shown) {
  if (order === null || shown.isJoin) order = new DepthOrder(shown.numSlots);
  for (const { slots, means, starts } of shown.updates) order.put(slots, means, starts);
  const before = shown.isJoin ? [] : (coming?.updates ?? []);
  coming = { ...shown, isJoin: shown.isJoin || (coming?.isJoin ?? false) };
  coming.updates = [...before, ...shown.updates];
  ({ frame, generation } = shown);
}

/** Sorts if that is wanted and there is something to sort. */
function sort() {
  if (!isWanted || order === null || view === null) return;
  isWanted = false;
  const beganMs = performance.now();
  const slots = order.farFirst(frame, view.w2c, view.nearM);
  const updates = coming?.updates ?? [];
  const isJoin = coming?.isJoin ?? false;
  coming = null;
  const sortMs = performance.now() - beganMs;
  const buffers = [/** @type {ArrayBuffer} */ (slots.buffer), ...updates.flatMap(buffersOf)];
  scope.postMessage({ frame, generation, isJoin, updates, order: slots, sortMs }, buffers);
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
  view = data.view;
  isWanted = true;
  sort();
};
