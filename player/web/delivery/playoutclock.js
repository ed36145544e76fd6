/**
 * What a playback waits for.
 * @typedef {object} PlayoutConfig
 * @property {number} startLeadS seconds of media that are there before the first frame shows
 * @property {number} resumeLeadS the same after a stall
 */

/** @type {PlayoutConfig} */
export const PLAYOUT_CONFIG = { startLeadS: 0.1, resumeLeadS: 0.1 };

/**
 * @param {number} leadS
 * @param {number} fps
 */
function leadFrames(leadS, fps) {
  return Math.max(1, Math.ceil(leadS * fps - 1e-9));
}

/** How many frames a playback may wait for. @param {PlayoutConfig} config @param {number} fps */
export function leastFrames(config, fps) {
  return Math.max(leadFrames(config.startLeadS, fps), leadFrames(config.resumeLeadS, fps));
}

/**
 * When frames show: the time line of one playback (server/abr/playout.py). It reads no clock.
 *
 * The first frame shows when so much is there as the configuration asks for; every later one frame
 * time after the one before. One that is not there by then stalls the picture until there is some lead
 * again, and what follows moves with it.
 */
export class PlayoutClock {
  /**
   * @param {number} firstFrame
   * @param {number} fps
   * @param {PlayoutConfig} config
   * @param {number | null} untilFrame the first frame that will not come; null while it is not known
   */
  constructor(firstFrame, fps, config = PLAYOUT_CONFIG, untilFrame = null) {
    this.config = config;
    this.firstFrame = firstFrame;
    this.fps = fps;
    this.untilFrame = untilFrame;
    /** The first frame that cannot show yet. */
    this.endFrame = firstFrame;
    /** The first frame that is not there; those before it may still wait for a lead. */
    this.hereFrame = firstFrame;
    this.stalls = 0;
    /** Of the stalls that are over. */
    this.stalledS = 0;
    /** @type {[number, number][]} (frame, when it showed) of the start, each stall, what was told */
    this.bases = [];
    this.beganS = 0;
  }

  /** When the first frame showed; null before. */
  get startedS() {
    return this.bases.length > 0 ? this.beganS : null;
  }

  /** When `frame` shows if nothing stalls any more, once playing has begun. @param {number} frame */
  dueS(frame) {
    const [baseFrame, baseS] = this.bases[this.bases.length - 1];
    return baseS + (frame - baseFrame) / this.fps;
  }

  /** The first frame that has not shown before `nowS`. @param {number} nowS */
  nextFrame(nowS) {
    if (this.bases.length === 0) return this.firstFrame;
    const [baseFrame, baseS] = this.bases[this.bases.length - 1];
    // A frame due at this very moment counts as next; rounding may not skip it.
    const passed = Math.ceil((nowS - baseS) * this.fps - 1e-6);
    return Math.min(this.endFrame, baseFrame + Math.max(0, passed));
  }

  /** Whether the picture stands still because the next frame is not there. @param {number} nowS */
  isStalled(nowS) {
    if (this.bases.length === 0 || this.#hasEnded) return false;
    return nowS > this.dueS(this.endFrame) + 1e-9;
  }

  /**
   * At `nowS` all that the frames before `endFrame` need is there.
   * @param {number} endFrame
   * @param {number} nowS
   */
  readyUntil(endFrame, nowS) {
    this.hereFrame = Math.max(this.hereFrame, endFrame);
    if (this.bases.length === 0) {
      if (this.#hasLead(this.firstFrame, this.config.startLeadS)) {
        this.beganS = nowS;
        this.bases.push([this.firstFrame, nowS]);
      }
    } else if (this.isStalled(nowS)) {
      if (!this.#hasLead(this.endFrame, this.config.resumeLeadS)) return;
      this.stalls += 1;
      this.stalledS += nowS - this.dueS(this.endFrame);
      this.bases.push([this.endFrame, nowS]);
    }
    this.endFrame = this.hereFrame;
  }

  /**
   * Whoever shows says that `frame` comes next, at `nowS`; from then on this time line is its own.
   * @param {number} frame
   * @param {number} nowS
   */
  told(frame, nowS) {
    const next = Math.min(frame, this.hereFrame);
    if (next > this.endFrame) this.endFrame = this.hereFrame;
    if (this.bases.length === 0) {
      if (next <= this.firstFrame) return;
      this.beganS = nowS;
    }
    const baseFrame = Math.max(next, this.firstFrame);
    while (this.bases.length > 0 && this.bases[this.bases.length - 1][0] >= baseFrame) {
      this.bases.pop();
    }
    this.bases.push([baseFrame, nowS + (baseFrame - next) / this.fps]);
  }

  /** Times before those of `frame` are not asked for any more. @param {number} frame */
  forget(frame) {
    while (this.bases.length > 2 && this.bases[2][0] <= frame) this.bases.shift();
  }

  get #hasEnded() {
    return this.untilFrame !== null && this.endFrame >= this.untilFrame;
  }

  /**
   * @param {number} frame
   * @param {number} leadS
   */
  #hasLead(frame, leadS) {
    let needed = frame + leadFrames(leadS, this.fps);
    if (this.untilFrame !== null) needed = Math.min(needed, Math.max(this.untilFrame, frame + 1));
    return this.hereFrame >= needed;
  }
}
