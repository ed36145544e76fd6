/** Whole objects of a static host in the cache of a stream's packets. */

import { isKeyframe } from "../format/manifest.js";
import { isWhole } from "./segmentcache.js";

/** @typedef {import("../format/manifest.js").Part} Part */
/** @typedef {import("./segmentcache.js").SegmentCache} SegmentCache */

const EMPTY = new Uint8Array(0);

/**
 * Adds the packets of an object; a frame without a packet counts as unchanged.
 * @param {SegmentCache} cache
 * @param {Pick<import("../format/objects.js").SegmentRecord, "firstFrame" | "numFrames">} record @param {Part} part
 * @param {Map<number, Uint8Array>} packets by birth
 */
export function addObject(cache, { firstFrame, numFrames }, part, packets) {
  const isOne = isKeyframe(cache, part);
  for (let birth = firstFrame; birth < firstFrame + (isOne ? 1 : numFrames); birth++) {
    const packet = packets.get(birth) ?? (isOne ? null : EMPTY);
    if (packet !== null) cache.add(birth, part, packet);
  }
}

/**
 * Whether all packets of an object are cached.
 * @param {SegmentCache} cache @param {number} segment @param {Part} part @param {number} numFrames of the segment
 */
export function hasObject(cache, segment, part, numFrames) {
  const row = cache.segments.get(segment)?.rows[part];
  return row !== undefined && isWhole(row, 0, isKeyframe(cache, part) ? 1 : numFrames);
}
