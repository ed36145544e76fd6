/** Seconds of media that are there before playing begins, or goes on after a stall. */
const LEAD_S = 0.1;

/** What comes late shows so often while playback is paused: all of the picture is sent anew for it. */
const REFINE_S = 0.2;

/** A seek over more frames than this begins anew. */
const MOST_STEPPED = 30;

/** A frame that is late by more than this shows at once, and those after it count from there. */
const LATE_S = 0.25;
/** While sound leads, which goes on meanwhile. */
const LATE_FOR_SOUND_S = 1;

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
   * @param {import("./streamplay.js").StreamPlay} play
   * @param {number} fps
   * @param {number} numFrames
   * @param {number} firstFrame
   * @param {number} [notBeforeS] when firstFrame is due
   */
  constructor(play, fps, numFrames, firstFrame, notBeforeS = -Infinity) {
    this.notBeforeS = notBeforeS;
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
    this.lateS = LATE_S;
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
      this.waiting = !this.#hasLead();
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
      shown = this.#advance(shown);
      if (nowS - this.dueS > this.lateS) this.dueS = nowS;
      this.dueS += stepS;
    }
    return shown;
  }

  /**
   * Goes on to a later frame that is here, at once; null if it is none, or too far away.
   * @param {number} frame
   * @returns {Shown | null}
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
   * Shows the next frame, with what was not shown of those before.
   * @param {Shown | null} before
   * @returns {Shown}
   */
  #advance(before) {
    const frame = this.nextFrame;
    const { isJoin, updates } = this.play.advance(frame);
    this.nextFrame = frame + 1;
    if (before === null || isJoin) return { frame, isJoin, updates };
    return { frame, isJoin: before.isJoin, updates: [...before.updates, ...updates] };
  }

  /** Whether its first frame is not due yet: that of the round before still shows. @param {number} nowS */
  isEarly(nowS) {
    return !this.isJoined && this.notBeforeS > nowS;
  }

  /** When frame 0 is or was due by what is due next; null while nothing runs. @param {number} nowS */
  zeroS(nowS) {
    const isNear = !this.isJoined && this.playing && nowS - this.notBeforeS < LATE_S;
    const early = isNear ? this.notBeforeS : null;
    const dueS = this.dueS ?? early;
    return dueS === null ? null : dueS - this.nextFrame / (this.fps * this.rate);
  }

  /** Follows sound: all that is due comes later by so much. @param {number} byS */
  follow(byS) {
    this.lateS = LATE_FOR_SOUND_S;
    this.notBeforeS += byS;
    if (this.dueS !== null) this.dueS += byS;
  }

  /** Seconds until something may be due; null: not before something comes. @param {number} nowS */
  restS(nowS) {
    if (this.isEarly(nowS)) return this.notBeforeS - nowS;
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
    return this.resend();
  }

  /** All that shows, once more. @returns {Shown} */
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
    if (this.playing && isOnTime && this.#hasLead()) {
      this.dueS = this.notBeforeS + 1 / (this.fps * this.rate);
    }
    return { frame, isJoin: true, updates };
  }

  /** Whether enough is here to play on. */
  #hasLead() {
    const lead = this.nextFrame + Math.ceil(LEAD_S * this.fps);
    return this.endFrame >= (this.live ? lead : Math.min(this.numFrames, lead));
  }

  /** Notes how far playing can go without a gap. */
  #reach() {
    if (!this.isJoined) return;
    const { numFrames } = this;
    while (this.endFrame < numFrames && this.play.canAdvance(this.endFrame, numFrames))
      this.endFrame += 1;
  }
}
