/** A snapshot: all slots of one layer at a segment's first frame (FORMAT.md, section 11). */

import { EMPTY, NEW } from "../../constants.js";
import { readChange } from "./change.js";
import { corrupt } from "../bytes/errors.js";
import { SNAPSHOT, readSlotHead } from "./slotchunk.js";
import { Slots } from "./slots.js";

/**
 * @typedef {object} Snapshot
 * @property {number} frame
 * @property {number} layer
 * @property {Slots[]} lanes the lanes of births frame - swinSize + 1 .. frame
 */

/**
 * Decodes a snapshot, of any layer and segment. Throws a FormatError.
 * @param {import("./slotlayout.js").SlotLayout} layout
 * @param {Uint8Array} bytes
 * @returns {Snapshot}
 */
export function decodeSnapshot(layout, bytes) {
  const { layer, birth: frame, hasStarts, body } = readSlotHead(bytes, SNAPSHOT);
  if (layer >= layout.numLayers)
    throw corrupt(`snapshot: layer ${layer}, but the stream has ${layout.numLayers} layers`);
  if (frame < 0 || frame !== layout.segmentStart(frame)) {
    throw corrupt(`snapshot: frame ${frame} is not the first frame of a segment`);
  }
  const count = layout.slots[layer];
  const numFlags = layout.swinSize * count;
  const flags = body.take(Math.ceil(numFlags / 8));
  if (numFlags % 8 !== 0 && flags[flags.length - 1] >> numFlags % 8 !== 0) {
    throw corrupt("snapshot: a bit is set after the last flag");
  }
  const statuses = new Uint8Array(numFlags);
  let numNew = 0;
  for (let i = 0; i < numFlags; i++) {
    if ((flags[i >> 3] >> (i & 7)) & 1) {
      statuses[i] = NEW;
      numNew++;
    }
  }
  const change = readChange(layout, layer, body, 0, numNew, hasStarts);
  // All lanes are decoded as if they were one, and then separated.
  const all = new Slots(numFlags, layout.numAttributes, EMPTY);
  all.advance(all.delta(statuses, change, layout.lattices[layer].opacityLevels));
  const lanes = Array.from({ length: layout.swinSize }, (_, lane) => part(all, lane, count));
  for (const [row, values] of all.escapes) {
    lanes[Math.floor(row / count)].escapes.set(row % count, values);
  }
  return { frame, layer, lanes };
}

/**
 * The slots of one lane, without the escaped Gaussians.
 * @param {Slots} all
 * @param {number} lane
 * @param {number} count of a lane
 */
function part(all, lane, count) {
  const first = lane * count;
  const end = first + count;
  const width = all.numAttributes;
  const made = new Slots(0, width, EMPTY);
  made.count = count;
  made.conditions = all.conditions.slice(first, end);
  made.positions = all.positions.slice(3 * first, 3 * end);
  made.attributes = all.attributes.slice(width * first, width * end);
  made.starts = all.starts.slice(first, end);
  return made;
}
