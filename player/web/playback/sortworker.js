/**
 * Sorts in a separate thread: receives changes from the decoding thread and the camera from the drawing
 * thread, and sends the drawing thread the changes together with the order in which to draw.
 */

import { spareSlots } from "../format/slots/slots.js";
import { DepthOrder, PendingUpdates } from "./depthorder.js";

/** @typedef {import("./messages.js").ShownFrame} ShownFrame */
/** @typedef {import("./messages.js").SortedFrame} SortedFrame */
/** @typedef {import("./messages.js").ToSorter} ToSorter */

const scope = /** @type {import("./messages.js").Channel<SortedFrame, ToSorter>} */ (
  /** @type {unknown} */ (self)
);

const NONE = new Uint32Array();

/** @type {DepthOrder | null} */
let order = null;
/** @type {ShownFrame | null} */
let newest = null;
/** @type {import("./frameassembler.js").SplatUpdate | null} the newest one, while it counts as half way there */
let moving = null;
/** @type {PendingUpdates | null} */
let pending = null;
let isWhole = false;
/** @type {import("./messages.js").View | null} the pending request */
let wanted = null;
/** Whether a frame or a camera has arrived since the last order. */
let isStale = false;

/** @param {ShownFrame} shown */
function take(shown) {
  if (order === null || pending === null || shown.isJoin) {
    order = new DepthOrder(shown.numSlots, spareSlots(shown.numSlots));
    pending = new PendingUpdates(shown.numSlots, shown.shDegree);
    moving = null;
    isWhole = true;
  }
  for (const update of shown.updates) {
    settle(order);
    const { frame } = update;
    const leaving = order.leave(frame === shown.frame ? update.leaving : NONE, frame);
    order.put(update.slots, update.means, update.starts, update.moves);
    moving = update;
    // A join appears at once, without motion; so does everything if the page is far behind.
    if (!pending.add({ ...update, frame: shown.isJoin ? -1 : frame, leaving })) settle(order);
  }
  newest = shown;
  isStale = true;
}

/** Ends all motion: moving Gaussians arrive, fading ones are removed. @param {DepthOrder} order */
function settle(order) {
  if (moving !== null) order.put(moving.slots, moving.means, moving.starts);
  moving = null;
  order.leave(NONE, 0);
}

/** Answers the drawing thread as soon as there is something new. */
function sort() {
  if (wanted === null || order === null || newest === null || pending === null || !isStale) return;
  if (!wanted.isMoving) settle(order);
  const beganMs = performance.now();
  const slots = order.farFirst(newest.frame, wanted.w2c, wanted.nearM);
  const sortMs = performance.now() - beganMs;
  const updates = pending.take();
  const { frame, seeks } = newest;
  const { request } = wanted;
  const sorted = { request, frame, seeks, isWhole, updates, order: slots, sortMs };
  const arrays = updates.flatMap(({ lattice, floats, leaving }) => [lattice, floats, leaving]);
  wanted = null;
  isWhole = false;
  isStale = false;
  scope.postMessage(
    sorted,
    [slots, ...arrays].map((array) => /** @type {ArrayBuffer} */ (array.buffer)),
  );
}

scope.onmessage = (/** @type {MessageEvent<ToSorter>} */ { data }) => {
  if ("port" in data) {
    data.port.onmessage = (/** @type {MessageEvent<ShownFrame>} */ event) => {
      take(event.data);
      sort();
    };
    return;
  }
  wanted = data.view;
  isStale ||= data.isMoved;
  sort();
};
