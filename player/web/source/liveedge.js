/** The live edge at which a growing stream is joined, and the period at which its growth is checked. */

const LEAST_PERIOD_S = 0.5;
const MOST_PERIOD_S = 5;
/** Time for fetching a segment, in addition to the time until it is noticed. */
const MARGIN_S = 0.5;
/** A picture counts as behind if it is older than the edge by more than this. */
const BEHIND_S = 3;

/** @typedef {{ fps: number, segmentFrames: number }} Shape of a stream */

/** Seconds between two checks of the index: about a segment. @param {Shape} shape */
export function followPeriodS({ fps, segmentFrames }) {
  return Math.min(MOST_PERIOD_S, Math.max(LEAST_PERIOD_S, segmentFrames / fps));
}

/**
 * The live edge: the first frame of a segment. The frames after it last until the next segment is
 * written, found and fetched, if frames are produced as fast as they are shown.
 * @param {Shape} shape @param {number} numFrames
 */
export function edgeFrame(shape, numFrames) {
  const { fps, segmentFrames } = shape;
  const heldFrames = segmentFrames + fps * (followPeriodS(shape) + MARGIN_S);
  return Math.max(0, Math.floor((numFrames - heldFrames) / segmentFrames) * segmentFrames);
}

/**
 * Whether the picture is more than BEHIND_S behind the edge of a live stream.
 * @param {Shape} shape @param {number} numFrames @param {number} frame the one that shows
 */
export function isBehind(shape, numFrames, frame) {
  return frame < edgeFrame(shape, numFrames) - BEHIND_S * shape.fps;
}
