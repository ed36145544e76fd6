/** Seconds of media that must have arrived before playback begins, or continues after a stall. */
const LEAD_S = 0.1;
/** The same, as a multiple of the time to a first byte. */
const WAITS = 2;
/**
 * The same after a second stall within CALM_S of playback, or after the first one over a link that carries
 * less than layer 0; it doubles with each further one.
 */
const LONGER_LEAD_S = 1;
const LONGEST_LEAD_S = 4;
/** A live stream would fall behind its edge. */
const LONGEST_LIVE_LEAD_S = 2;
const CALM_S = 20;

/** Period at which late data is shown during a pause; each time the whole picture is sent again. */
const REFINE_S = 0.2;

/** A seek over more frames than this rejoins the stream. */
const MOST_STEPPED = 30;

/** If a frame is later than this, it shows at once, and the following frames are due relative to it. */
const LATE_S = 0.25;
/** The same while playback follows sound, which continues meanwhile. */
const LATE_FOR_SOUND_S = 1;

/**
 * A frame to show now, with all its updates.
 * @typedef {object} Shown
 * @property {number} frame
 * @property {boolean} isJoin whether the updates are complete, so that earlier Gaussians must be dropped
 * @property {import("./frameassembler.js").SplatUpdate[]} updates
 */

/**
 * Decides which frame shows when: play, pause, seek, loop, rate and stalls. It reads no clock: callers pass the time.
 */
export class Playback {
  /** Whether more frames may follow. */
  live = false;
  isJoined = false;
  playing = false;
  rate = 1;
  /** @type {number | null} when nextFrame is due; null while playback does not run */
  dueS = null;
  /** Whether playback waits for missing data. */
  waiting = true;
  stalls = 0;
  leadS = LEAD_S;
  /** When playback went on after the last stall. */
  resumedS = -Infinity;
  /**
   * The first frame that has not arrived; endFrame goes not as far ahead. Set by a caller that knows it:
   * otherwise no lead is longer than the first one.
   */
  heldFrame = Infinity;
  /** Seconds from a request to its first byte, 0 where others decide what is sent. Set by the caller. */
  waitS = 0;
  /** Whether the link carries less than layer 0. Set by the caller. */
  isLinkThin = false;
  refinedS = -Infinity;
  lateS = LATE_S;

  /**
   * @param {import("./frameassembler.js").FrameAssembler} play @param {number} fps @param {number} numFrames
   * @param {number} firstFrame @param {number} [notBeforeS] when firstFrame is due
   */
  constructor(play, fps, numFrames, firstFrame, notBeforeS = -Infinity) {
    /** @type {number} */ this.notBeforeS = notBeforeS;
    this.play = play;
    /** @type {number} */ this.fps = fps;
    /** Number of frames so far. @type {number} */
    this.numFrames = numFrames;
    /** The frame that shows next. @type {number} */
    this.nextFrame = firstFrame;
    /** The first frame that is missing. @type {number} */
    this.endFrame = firstFrame;
  }

  /** The frame that shows; before the first one, the frame that will show first. */
  get frame() {
    return this.isJoined ? this.nextFrame - 1 : this.nextFrame;
  }

  /** Whether the last frame has shown. */
  get hasEnded() {
    return this.isJoined && !this.live && this.nextFrame >= this.numFrames;
  }

  /** Plays or pauses. @param {boolean} playing */
  setPlaying(playing) {
    this.playing = playing;
    this.dueS = null;
  }

  /** Sets the playback rate; 1 is normal speed. @param {number} rate */
  setRate(rate) {
    this.rate = rate;
    this.dueS = null;
  }

  /**
   * The frame that is due at `nowS`; null if there is nothing new. Throws a FormatError.
   * @param {number} nowS @returns {Shown | null}
   */
  tick(nowS) {
    this.#reach();
    if (this.isEarly(nowS)) {
      this.waiting = false;
      return null;
    }
    if (!this.isJoined) return this.#join(nowS);
    if (!this.playing || this.hasEnded) {
      this.waiting = false;
      this.dueS = null;
      return this.#refine(nowS);
    }
    const stepS = 1 / (this.fps * this.rate);
    if (this.dueS === null) {
      const isCalm = nowS - this.resumedS > CALM_S;
      if (isCalm && !this.waiting) this.leadS = LEAD_S;
      if (!this.#hasLead()) {
        this.waiting = true;
        return null;
      }
      if (this.waiting && this.stalls > 0) this.resumedS = nowS;
      this.waiting = false;
      this.dueS = nowS + stepS;
      return null;
    }
    /** @type {Shown | null} */
    let shown = null;
    while (this.dueS <= nowS && !this.hasEnded) {
      if (this.nextFrame >= this.endFrame) {
        this.#stall(nowS);
        break;
      }
      shown = this.#advance(shown);
      if (nowS - this.dueS > this.lateS) this.dueS = nowS;
      this.dueS += stepS;
    }
    return shown;
  }

  /** @param {number} nowS */
  #stall(nowS) {
    this.stalls += 1;
    this.waiting = true;
    this.dueS = null;
    const isAgain = this.isLinkThin || nowS - this.resumedS <= CALM_S;
    const most = this.live ? LONGEST_LIVE_LEAD_S : LONGEST_LEAD_S;
    this.leadS = isAgain ? Math.min(most, Math.max(LONGER_LEAD_S, 2 * this.leadS)) : LEAD_S;
  }

  /** Whether a frame shows, and playback waits for no data. */
  get canGoOn() {
    return this.isJoined && !this.waiting;
  }

  /** Whether playback stalls and waits for a longer lead again and again. */
  get isStuttering() {
    return this.waiting && this.leadS > LONGER_LEAD_S;
  }

  /**
   * Advances at once to a later frame; null if the frame is not later, too far away or missing.
   * @param {number} frame @returns {Shown | null}
   */
  stepTo(frame) {
    this.#reach();
    const isNear = frame >= this.nextFrame && frame < this.nextFrame + MOST_STEPPED;
    if (!this.isJoined || !isNear || frame >= this.endFrame) return null;
    this.dueS = null;
    /** @type {Shown | null} */
    let shown = null;
    while (this.nextFrame <= frame) shown = this.#advance(shown);
    return shown;
  }

  /**
   * Shows the next frame, together with the updates of frames that were skipped.
   * @param {Shown | null} before @returns {Shown}
   */
  #advance(before) {
    const frame = this.nextFrame;
    const { isJoin, updates } = this.play.advance(frame);
    this.nextFrame = frame + 1;
    if (before === null || isJoin) return { frame, isJoin, updates };
    return { frame, isJoin: before.isJoin, updates: [...before.updates, ...updates] };
  }

  /** Whether the first frame is not due yet and the previous round still shows. @param {number} nowS */
  isEarly(nowS) {
    return !this.isJoined && this.notBeforeS > nowS;
  }

  /** Due time of frame 0, derived from the next frame; null while not running. @param {number} nowS */
  zeroS(nowS) {
    const isNear = !this.isJoined && this.playing && nowS - this.notBeforeS < LATE_S;
    const early = isNear ? this.notBeforeS : null;
    const dueS = this.dueS ?? early;
    return dueS === null ? null : dueS - this.nextFrame / (this.fps * this.rate);
  }

  /** Follows sound: delays all due times. @param {number} byS */
  follow(byS) {
    this.lateS = LATE_FOR_SOUND_S;
    this.notBeforeS += byS;
    if (this.dueS !== null) this.dueS += byS;
  }

  /** Seconds until something may be due; null: not before more data arrives. @param {number} nowS */
  restS(nowS) {
    if (this.isEarly(nowS)) return this.notBeforeS - nowS;
    if (this.dueS === null) return this.play.isLate ? REFINE_S : null;
    return Math.max(0, this.dueS - nowS);
  }

  /**
   * The current frame again, if late data has improved it. Not needed during playback, where each frame
   * brings the late data itself.
   * @param {number} nowS @returns {Shown | null}
   */
  #refine(nowS) {
    if (!this.play.isLate || nowS - this.refinedS < REFINE_S) return null;
    this.refinedS = nowS;
    return this.resend();
  }

  /** The whole current frame again. @returns {Shown} */
  resend() {
    return { frame: this.frame, isJoin: true, updates: this.play.again(this.frame) };
  }

  /** @param {number} nowS */
  #join(nowS) {
    const frame = this.nextFrame;
    this.waiting = !this.play.has(frame);
    if (this.waiting) return null;
    const updates = this.play.join(frame);
    this.isJoined = true;
    this.nextFrame = frame + 1;
    this.endFrame = this.nextFrame;
    this.#reach();
    const isOnTime = nowS - this.notBeforeS < LATE_S;
    if (this.playing && isOnTime && this.#hasLead())
      this.dueS = this.notBeforeS + 1 / (this.fps * this.rate);
    return { frame, isJoin: true, updates };
  }

  /** Whether enough data has arrived to continue playback. */
  #hasLead() {
    const { numFrames, endFrame } = this;
    const after = (/** @type {number} */ leadS) => this.nextFrame + Math.ceil(leadS * this.fps);
    const least = this.live ? after(LEAD_S) : Math.min(numFrames, after(LEAD_S));
    // A longer lead is for the link: frames that do not exist yet are not waited for.
    const held = Math.max(endFrame, this.heldFrame);
    // From a far host, what follows comes a round trip after it was requested, the first parts slowly.
    const leadS = Math.max(this.leadS, WAITS * this.waitS);
    return endFrame >= least && held >= Math.min(numFrames, after(leadS));
  }

  /** Updates endFrame, the end of the frames that can be played without a gap. */
  #reach() {
    if (!this.isJoined) return;
    const { numFrames } = this;
    while (this.endFrame < numFrames && this.play.canAdvance(this.endFrame, numFrames))
      this.endFrame += 1;
  }
}
