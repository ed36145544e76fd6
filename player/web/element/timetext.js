/** A clip shorter than this shows tenths of seconds, because whole seconds hardly move. */
const SHORT_S = 10;

/**
 * A duration as text: 1:07, 1:00:07, or 0:07.3 with tenths.
 * @param {number} seconds
 * @param {boolean} [hasTenths]
 */
export function timeText(seconds, hasTenths = false) {
  // Rounding may put a frame's time just below its tenth.
  const tenths = Math.max(0, Math.floor(seconds * 10 + 1e-6));
  const whole = Math.floor(tenths / 10);
  const minutes = Math.floor(whole / 60) % 60;
  const hours = Math.floor(whole / 3600);
  const pad = (/** @type {number} */ n) => String(n).padStart(2, "0");
  const rest = `${hours ? pad(minutes) : minutes}:${pad(whole % 60)}`;
  return `${hours ? `${hours}:` : ""}${rest}${hasTenths ? `.${tenths % 10}` : ""}`;
}

/**
 * The time of a frame: since the first frame, or behind the edge of a live stream.
 * @param {number} frame
 * @param {number} numFrames
 * @param {number} fps
 * @param {boolean} live
 */
export function frameTimeText(frame, numFrames, fps, live) {
  if (live) return `-${timeText((numFrames - 1 - frame) / fps)}`;
  return timeText(frame / fps, isShort(numFrames, fps));
}

/**
 * The time of a frame, and the stream's length. The last frame counts as the end.
 * @param {number} frame
 * @param {number} numFrames
 * @param {number} fps
 * @param {boolean} live
 */
export function positionText(frame, numFrames, fps, live) {
  if (live) return frameTimeText(frame, numFrames, fps, live);
  const isLast = frame > 0 && frame === numFrames - 1;
  const now = frameTimeText(isLast ? numFrames : frame, numFrames, fps, live);
  return `${now} / ${timeText(numFrames / fps, isShort(numFrames, fps))}`;
}

/**
 * @param {number} numFrames
 * @param {number} fps
 */
function isShort(numFrames, fps) {
  return numFrames > 0 && numFrames / fps < SHORT_S;
}
