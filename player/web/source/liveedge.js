/** Where a live stream that grows by segments is joined, and how often it is asked whether it grew. */

const LEAST_PERIOD_S = 0.5;
const MOST_PERIOD_S = 5;
/** For what a segment takes on its way, beyond the time until somebody asks for it. */
const MARGIN_S = 0.5;
/** Behind the edge by more than this is behind. */
const BEHIND_S = 3;

/** @typedef {{ fps: number, segmentFrames: number }} Shape of a stream */

/** Seconds from one look at the index to the next: about a segment. @param {Shape} shape */
export function followPeriodS({ fps, segmentFrames }) {
  return Math.min(MOST_PERIOD_S, Math.max(LEAST_PERIOD_S, segmentFrames / fps));
}

/**
 * The live edge: the first frame of a segment, with as much behind it as lasts until the next segment
 * is written, found and fetched, if frames are made as fast as they are shown.
 * @param {Shape} shape
 * @param {number} numFrames
 */
export function edgeFrame(shape, numFrames) {
  const { fps, segmentFrames } = shape;
  const heldFrames = segmentFrames + fps * (followPeriodS(shape) + MARGIN_S);
  return Math.max(0, Math.floor((numFrames - heldFrames) / segmentFrames) * segmentFrames);
}

/**
 * Whether what shows is some seconds older than what a live stream has.
 * @param {Shape} shape
 * @param {number} numFrames
 * @param {number} frame that shows
 */
export function isBehind(shape, numFrames, frame) {
  return frame < edgeFrame(shape, numFrames) - BEHIND_S * shape.fps;
}
