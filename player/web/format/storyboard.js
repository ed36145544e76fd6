/** The storyboard: small pictures of a finished stream, in one file (FORMAT.md, section 4). */

import { MAX_STORYBOARD_TILES, STORYBOARD_COLUMNS, STORYBOARD_PER_S } from "../constants.js";

/**
 * @typedef {object} StoryboardLayout
 * @property {number} stepFrames from one tile to the next
 * @property {number} numTiles
 * @property {number} columns
 * @property {number} rows
 */

/**
 * The arrangement of the tiles in a stream's storyboard.
 * @param {number} numFrames
 * @param {number} fps
 * @returns {StoryboardLayout}
 */
export function storyboardLayout(numFrames, fps) {
  const stepFrames = Math.max(
    Math.ceil(fps / STORYBOARD_PER_S),
    Math.ceil(numFrames / MAX_STORYBOARD_TILES),
  );
  const numTiles = Math.ceil(numFrames / stepFrames);
  const columns = Math.min(STORYBOARD_COLUMNS, numTiles);
  return { stepFrames, numTiles, columns, rows: Math.ceil(numTiles / columns) };
}

/**
 * The tile that shows `frame`, or the nearest frame before it.
 * @param {StoryboardLayout} layout
 * @param {number} frame
 */
export function tileOf({ stepFrames, numTiles }, frame) {
  return Math.max(0, Math.min(numTiles - 1, Math.floor(frame / stepFrames)));
}
