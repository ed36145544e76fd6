/**
 * What may be asked for next: of the slices birth .. endBirth - 1 some layers, or snapshots.
 * @typedef {{ kind: "slices", birth: number, endBirth: number, firstLayer: number, endLayer: number }} SendSlices
 * @typedef {{ kind: "snapshots", frame: number, firstLayer: number, endLayer: number }} SendSnapshots
 * @typedef {SendSlices | SendSnapshots} Send
 */

/**
 * How things stand when something may be asked for (server/abr/outlook.py).
 * @typedef {object} Standing
 * @property {import("./media.js").Media} media
 * @property {import("./playoutclock.js").PlayoutClock} clock
 * @property {number} nowS
 * @property {number} rateBps estimated throughput; a guess until there is an estimate
 * @property {boolean} measured whether rateBps is an estimate
 * @property {number} queuedBytes asked for, but not here
 * @property {number} latencyS from the asking to the first byte, over an idle link
 * @property {number} nextFrame the first frame that has not shown
 * @property {number} endBirth the first slice that may not be asked for yet
 * @property {number} runS seconds of the link that one answer may fill
 * @property {boolean} paused whether nextFrame shows, and goes on to
 */

/** A standing, and what follows from it. */
export class Outlook {
  /** @param {Standing} standing */
  constructor(standing) {
    this.media = standing.media;
    this.clock = standing.clock;
    this.nowS = standing.nowS;
    this.rateBps = standing.rateBps;
    this.measured = standing.measured;
    this.queuedBytes = standing.queuedBytes;
    this.latencyS = standing.latencyS;
    this.nextFrame = standing.nextFrame;
    this.endBirth = standing.endBirth;
    this.runS = standing.runS;
    this.paused = standing.paused;
  }

  /** When the slice shows first; now, before playing has begun. @param {number} birth */
  dueS(birth) {
    const { clock, media, nowS } = this;
    const frame = Math.max(birth, clock.firstFrame);
    if (clock.startedS === null) return nowS + (frame - clock.firstFrame) / media.fps;
    if (clock.isStalled(nowS)) return nowS + (frame - clock.endFrame) / media.fps;
    return clock.dueS(frame);
  }

  /**
   * When bytes that are asked for now have come, over a link of `rateBps`.
   * @param {number} numBytes
   * @param {number} rateBps
   */
  comesS(numBytes, rateBps) {
    return this.nowS + this.latencyS + (8 * (this.queuedBytes + numBytes)) / rateBps;
  }

  /**
   * How many packets of `numBytes` one answer may hold over a link of `rateBps`.
   * @param {number} numBytes
   * @param {number} rateBps
   */
  runLength(numBytes, rateBps) {
    return Math.max(1, Math.trunc((rateBps * this.runS) / 8 / Math.max(1, numBytes)));
  }
}
