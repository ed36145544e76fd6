/** Seconds of media that are there before playing begins, or goes on after a stall. */
const LEAD_S = 0.1;

/** What comes late shows so often while playback is paused: all of the picture is sent anew for it. */
const REFINE_S = 0.2;

/** A frame that is late by more than this shows at once, and those after it count from there. */
const LATE_S = 0.25;

/**
 * What to show now, all at once.
 * @typedef {object} Shown
 * @property {number} frame
 * @property {boolean} isJoin whether it begins anew: what the renderer holds is of no use
 * @property {import("./packing.js").SplatUpdate[]} updates
 */

/**
 * Which frame shows when: play, pause, seek, loop and rate, stalls and what ends them. It reads no
 * clock.
 */
export class Playback {
  /**
   * @param {import("./slotplay.js").SlotPlay | import("./sliceplay.js").SlicePlay} play
   * @param {number} fps
   * @param {number} numFrames
   * @param {number} firstFrame
   */
  constructor(play, fps, numFrames, firstFrame) {
    this.play = play;
    this.fps = fps;
    /** Frames that there are now. */
    this.numFrames = numFrames;
    /** Whether there may be more later. */
    this.live = false;
    /** The frame that shows next. */
    this.nextFrame = firstFrame;
    /** The first frame that is not there. */
    this.endFrame = firstFrame;
    this.isJoined = false;
    this.playing = false;
    this.rate = 1;
    /** @type {number | null} when nextFrame is due; null while nothing runs */
    this.dueS = null;
    /** Whether it would play, but for what is not there. */
    this.waiting = true;
    this.stalls = 0;
    this.refinedS = -Infinity;
  }

  /** The frame that shows; that which will show first, before anything does. */
  get frame() {
    return this.isJoined ? this.nextFrame - 1 : this.nextFrame;
  }

  /** Whether the last frame has shown. */
  get hasEnded() {
    return this.isJoined && !this.live && this.nextFrame >= this.numFrames;
  }

  /**
   * Plays or pauses.
   * @param {boolean} playing
   */
  setPlaying(playing) {
    this.playing = playing;
    this.dueS = null;
  }

  /** Frames shown in a second are `rate` times those of the stream. @param {number} rate */
  setRate(rate) {
    this.rate = rate;
    this.dueS = null;
  }

  /**
   * What is due at `nowS`; null if nothing new is. Throws a FormatError.
   * @param {number} nowS
   * @returns {Shown | null}
   */
  tick(nowS) {
    this.#reach();
    if (!this.isJoined) return this.#join();
    if (!this.playing || this.hasEnded) {
      this.waiting = false;
      this.dueS = null;
      return this.#refine(nowS);
    }
    const stepS = 1 / (this.fps * this.rate);
    if (this.dueS === null) {
      const lead = this.nextFrame + Math.ceil(LEAD_S * this.fps);
      const needed = this.live ? lead : Math.min(this.numFrames, lead);
      this.waiting = this.endFrame < needed;
      if (this.waiting) return null;
      this.dueS = nowS + stepS;
      return null;
    }
    /** @type {Shown | null} */
    let shown = null;
    while (this.dueS <= nowS && !this.hasEnded) {
      if (this.nextFrame >= this.endFrame) {
        this.stalls += 1;
        this.waiting = true;
        this.dueS = null;
        break;
      }
      const frame = this.nextFrame;
      const updates = this.play.advance(frame);
      this.nextFrame = frame + 1;
      shown = { frame, isJoin: false, updates: shown ? [...shown.updates, ...updates] : updates };
      if (nowS - this.dueS > LATE_S) this.dueS = nowS;
      this.dueS += stepS;
    }
    return shown;
  }

  /** Seconds until something may be due; null: not before something comes. @param {number} nowS */
  restS(nowS) {
    if (this.dueS === null) return this.play.isLate ? REFINE_S : null;
    return Math.max(0, this.dueS - nowS);
  }

  /**
   * What shows, once more, if more of it has come: while frames pass, each brings what is late itself.
   * @param {number} nowS
   * @returns {Shown | null}
   */
  #refine(nowS) {
    if (!this.play.isLate || nowS - this.refinedS < REFINE_S) return null;
    this.refinedS = nowS;
    return { frame: this.frame, isJoin: true, updates: this.play.again(this.frame) };
  }

  #join() {
    const frame = this.nextFrame;
    this.waiting = !this.play.has(frame);
    if (this.waiting) return null;
    const updates = this.play.join(frame);
    this.isJoined = true;
    this.nextFrame = frame + 1;
    this.endFrame = this.nextFrame;
    this.#reach();
    return { frame, isJoin: true, updates };
  }

  /** Notes how far playing can go without a gap. */
  #reach() {
    if (!this.isJoined) return;
    while (this.endFrame < this.numFrames && this.play.hasSlice(this.endFrame)) this.endFrame += 1;
  }
}
