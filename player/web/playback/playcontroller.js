import { edgeFrame } from "../source/liveedge.js";
import { buffersOf } from "./frameassembler.js";
import { PlaySession } from "./playsession.js";

const STATE_PERIOD_S = 0.1;
/** A change of the frames' due times by more than this is reported to the page. */
const SAME_S = 0.002;
/** When more layers are wanted, frames that show within this time are not requested again. */
const SOON_S = 0.5;
/** The next round of a loop is requested this many seconds before it begins. */
const NEXT_ROUND_S = 5;

/** @typedef {import("../source/source.js").SourceStream} SourceStream */

const nowS = () => performance.now() / 1000;

/** @param {number} bps */
const mbit = (bps) => Number((bps / 1e6).toPrecision(2));

/**
 * Receivers of the player's messages.
 * @typedef {object} Outlet
 * @property {(message: import("./messages.js").FromPlayer) => void} post sends to the page
 * @property {(shown: import("./messages.js").ShownFrame, transfer: Transferable[]) => void} show sends to
 *   the thread that takes the frames
 * @property {(error: unknown) => void} fail
 */

/** Plays one stream after it was opened: rounds of a loop, seeks, scrubbing, layers. */
export class PlayController {
  playing = false;
  decodeMs = 0;
  postedS = 0;
  /** @type {number | null} due time of frame 0, as last reported to the page */
  zeroS = null;
  /** Number of the last line that was reported to the page. */
  line = 0;
  isClosed = false;
  /** @type {"unknown" | "said" | "known"} whether the viewer was told that the link is too thin */
  thinLink = "unknown";
  /** @type {number | undefined} */
  timer = undefined;
  /** @type {PlaySession | null} the next round of a loop, begun ahead */
  nextRound = null;
  /** @type {import("./keyframepreview.js").KeyframePreview | null} */
  scrubber = null;

  /**
   * @param {SourceStream} stream @param {import("../source/fetcher.js").Fetcher} fetcher
   * @param {Outlet} outlet @param {import("./messages.js").Start} [start]
   */
  constructor(stream, fetcher, outlet, { frame, seeks, rate, loop, mostLayers } = {}) {
    /** @type {SourceStream} */ this.stream = stream;
    this.fetcher = fetcher;
    /** @type {Outlet} */ this.outlet = outlet;
    /** @type {boolean} */ this.loop = loop ?? false;
    /** Number of the page's last known seek. @type {number} */
    this.seeks = seeks ?? 0;
    /** @type {number} */ this.rate = rate ?? 1;
    /** @type {number} */ this.mostLayers = mostLayers ?? stream.manifest.numLayers;
    const { manifest, numFrames } = stream;
    this.round = this.#newRound(frame ?? (manifest.live ? edgeFrame(manifest, numFrames) : 0));
    this.wake();
  }

  get playback() {
    return this.round.playback;
  }

  /**
   * Seeks to `frame`. A live stream that plays is limited to its edge, beyond which too little data is
   * available to continue.
   * @param {number} frame @param {number} seeks number of seeks, including this one
   */
  seek(frame, seeks) {
    this.seeks = seeks;
    const { manifest, numFrames } = this.stream;
    const isBound = manifest.live && this.playing;
    const most = Math.max(edgeFrame(manifest, numFrames), this.playback.frame);
    this.begin(isBound ? Math.min(frame, most) : frame);
  }

  /** Shows a picture near `frame` while the thumb moves; a seek ends it. @param {number} frame */
  async scrub(frame) {
    const { seeks } = this;
    try {
      const loaded = this.scrubber ?? (await this.#loadScrubber());
      this.scrubber ??= loaded; // another call may have been faster
      if (seeks === this.seeks && !this.isClosed) this.scrubber.scrub(frame);
    } catch (error) {
      console.warn("swings: no pictures near the thumb:", error);
    }
  }

  async #loadScrubber() {
    const { KeyframePreview } = await import("./keyframepreview.js");
    const stopFetching = () => this.round.source.close();
    return new KeyframePreview(this.stream, (shown) => this.show(shown), stopFetching);
  }

  /** Whether pictures near the thumb show, instead of the play. */
  get isScrubbing() {
    return this.scrubber?.isActive ?? false;
  }

  /** To be called when a live stream has more frames, or has ended. */
  grow() {
    this.playback.numFrames = this.stream.numFrames;
    this.playback.live = this.stream.manifest.live;
    this.wake();
  }

  /** Plays from `frame` on, using the data that has arrived. @param {number} frame */
  begin(frame) {
    const isScrubbed = this.isScrubbing;
    this.scrubber?.end();
    const first = Math.max(0, Math.min(this.stream.numFrames - 1, Math.round(frame)));
    const stepped = isScrubbed ? null : this.playback.stepTo(first);
    if (stepped !== null) {
      if (!this.round.source.moveTo(first, "step"))
        this.round.replaceSource(this.#newSource(first));
      this.show(stepped);
    } else this.#replaceRound(this.#newRound(first, "seek"));
    this.#tellPosition();
    this.wake();
  }

  /**
   * @param {number} firstFrame
   * @param {"seek" | "loop" | null} [how] null: this round's source goes on, so the new one needs its own
   * @returns {PlaySession}
   */
  #newRound(firstFrame, how = null) {
    const { stream, mostLayers } = this;
    const goesOn = how !== null && this.round.source.moveTo(firstFrame, how);
    const source = goesOn ? this.round.detach() : this.#newSource(firstFrame);
    const round = new PlaySession(stream, source, firstFrame, mostLayers, this.rate);
    round.feed.onData = () => this.wake();
    return round;
  }

  /** @param {number} firstFrame */
  #newSource(firstFrame) {
    const source = this.stream.play({ firstFrame, mostLayers: this.mostLayers, nowS });
    source.onData = () => this.wake();
    return source;
  }

  /** @param {PlaySession} round */
  #replaceRound(round) {
    this.#dropNextRound();
    const { stalls, lateS } = this.playback;
    if (round.source === this.round.source) this.round.detach();
    else this.round.close();
    this.round = round;
    Object.assign(round.playback, { stalls, lateS });
    round.playback.setPlaying(this.playing);
  }

  #dropNextRound() {
    this.nextRound?.close();
    this.nextRound = null;
  }

  /** Begins the next round of a loop ahead, once this round has received all its data. */
  #prepareRound() {
    const { loop, playing, playback, stream } = this;
    const restS = (stream.numFrames - playback.nextFrame) / (playback.fps * this.rate);
    const isDue =
      loop && playing && stream.numFrames > 1 && !stream.manifest.live && restS < NEXT_ROUND_S;
    if (!isDue || !this.round.source.isDone || this.isScrubbing) {
      if (!loop) this.#dropNextRound();
      return;
    }
    this.nextRound ??= this.#newRound(0);
    this.nextRound.source.reportPosition(playback.nextFrame - stream.numFrames, false, this.rate);
    if (this.nextRound.failure !== null) throw this.nextRound.failure;
  }

  /** Called when the last frame shows: starts the next round, or ends playback. */
  #end() {
    const { fps, numFrames } = this.playback;
    if (!this.loop) {
      this.playing = false;
      this.playback.setPlaying(false);
      this.outlet.post({ kind: "ended" });
      return;
    }
    if (numFrames === 1) return; // it stays
    const seamS = this.playback.dueS ?? nowS();
    if (this.zeroS !== null) this.zeroS += numFrames / (fps * this.rate);
    const round = this.nextRound ?? this.#newRound(0, "loop");
    this.nextRound = null;
    const { leadS, resumedS } = this.playback;
    Object.assign(round.playback, { leadS, resumedS, notBeforeS: seamS });
    round.playback.waiting = false;
    this.#replaceRound(round);
    this.#tellPosition();
    this.wake();
  }

  /**
   * Limits the number of layers. During playback, layers that are not cached are requested for frames from
   * SOON_S ahead on.
   * @param {number} most
   */
  setLayers(most) {
    const { playback, round } = this;
    if (most === this.mostLayers) return;
    const isMore = most > this.mostLayers;
    this.mostLayers = most;
    this.#dropNextRound();
    if (!playback.isJoined || !this.playing) {
      this.#replaceRound(this.#newRound(playback.frame));
    } else {
      const soon = playback.nextFrame + (isMore ? Math.round(SOON_S * playback.fps) : 0);
      round.feed.setLayers(most, playback.frame);
      round.replaceSource(this.#newSource(Math.min(soon, this.stream.numFrames - 1)));
    }
    this.#tellPosition();
    this.wake();
  }

  /** Plays or pauses; after the end, playback starts from the beginning. @param {boolean} playing */
  setPlaying(playing) {
    this.playing = playing;
    if (playing && this.playback.hasEnded) this.begin(0);
    else if (playing && this.isScrubbing) this.begin(this.playback.frame);
    this.playback.setPlaying(playing);
    this.#tellPosition();
  }

  /** @param {number} rate */
  setRate(rate) {
    this.rate = rate;
    this.zeroS = null;
    this.playback.setRate(rate);
    this.nextRound?.playback.setRate(rate);
  }

  /** Follows the page's sound if it refers to the same line. @param {{ line: number, byMs: number }} how */
  follow({ line, byMs }) {
    if (line !== this.line || this.zeroS === null) return;
    const byS = byMs / 1000;
    this.zeroS += byS;
    this.playback.follow(byS);
  }

  /** Reports the due times of frames to the page if they have changed. */
  #postLine() {
    const isRunning = this.playing && !this.isScrubbing;
    const zeroS = isRunning ? this.playback.zeroS(nowS()) : null;
    const differS = Math.abs((zeroS ?? Infinity) - (this.zeroS ?? Infinity)); // NaN: still none
    if (!(differS > SAME_S)) return;
    this.zeroS = zeroS;
    this.line += 1;
    const zeroMs = zeroS === null ? null : performance.timeOrigin + 1000 * zeroS;
    this.outlet.post({ kind: "line", zeroMs, rate: this.rate, line: this.line });
  }

  /** Schedules the next step for now. */
  wake() {
    clearTimeout(this.timer);
    if (!this.isClosed) this.timer = setTimeout(() => this.step(), 0);
  }

  step() {
    const { round, playback, playing } = this;
    try {
      if (this.isScrubbing) return this.#postLine();
      this.#noteLink();
      // A prepared round follows one that has all it needs, and what that began would be aborted.
      const waitS = ((playing && this.nextRound) || round).source.step();
      const beganMs = performance.now();
      const shown = playback.tick(nowS());
      if (shown !== null) {
        this.decodeMs = performance.now() - beganMs;
        this.show(shown);
      }
      // Also while it waits: an answer shows that the host is there.
      this.#tellPosition();
      // Play first what has arrived.
      if (round.failure !== null && !round.canGoOn) throw round.failure;
      this.#postLine();
      this.#prepareRound();
      this.postState();
      if (playback.hasEnded && playing) this.#end();
      const restS = Math.min(waitS, this.playback.restS(nowS()) ?? 1);
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.step(), 1000 * restS);
    } catch (error) {
      this.close();
      this.stream.explain(error).then((why) => this.outlet.fail(why));
    }
  }

  /**
   * Tells the playback what has arrived and whether the link is too thin, and once the viewer, while it
   * stutters for this reason.
   */
  #noteLink() {
    const { playback, round, rate } = this;
    const { cache, numFrames } = this.stream;
    const { endFrame } = round;
    // Frames for which there is no room will not arrive.
    playback.heldFrame = cache.hasRoomFor(cache.segmentOf(endFrame)) ? endFrame : Infinity;
    playback.waitS = round.source.waitS ?? 0;
    const needBps = rate * cache.baseBps(playback.frame);
    const rateBps = round.source.rateBps ?? Infinity;
    playback.isLinkThin = rateBps < needBps && endFrame < numFrames; // at a live edge none is missing
    if (playback.isStuttering && playback.isLinkThin && this.thinLink === "unknown") {
      this.thinLink = "said";
      this.#postTrouble(
        `This connection carries ${mbit(rateBps)} of the ${mbit(needBps)} Mbit/s that this video needs`,
      );
    } else if (this.thinLink === "said" && !playback.waiting) {
      this.thinLink = "known";
      this.#postTrouble(null);
    }
  }

  /** @param {string | null} message */
  #postTrouble(message) {
    this.outlet.post({ kind: "trouble", message });
  }

  /** @param {import("./playback.js").Shown} shown */
  show(shown) {
    const { numGs, shDegree } = this.stream.manifest;
    const message = { ...shown, numSlots: numGs, shDegree, seeks: this.seeks };
    this.outlet.show(message, shown.updates.flatMap(buffersOf));
  }

  /** Sends the whole current frame to a renderer that has lost it. */
  resend() {
    if (this.playback.isJoined) this.show(this.playback.resend());
  }

  /** Posts the current frame as a PLY file; null if that is not possible. */
  async postPly() {
    try {
      const { framePly } = await import("../format/ply.js");
      const { frame, play } = this.playback;
      this.outlet.post({ kind: "ply", message: { frame, file: framePly(play.decoder) } });
    } catch (error) {
      console.warn("swings: the frame could not be written:", error);
      this.outlet.post({ kind: "ply", message: null });
    }
  }

  #tellPosition() {
    this.round.tellPosition(this.playing, this.rate, this.loop);
  }

  /** Posts the state to the page, ten times a second at most. */
  postState() {
    const { playback, round, stream } = this;
    if (nowS() - this.postedS < STATE_PERIOD_S || playback.isEarly(nowS())) return;
    this.postedS = nowS();
    this.outlet.post({
      kind: "state",
      frame: playback.frame,
      endFrame: round.endFrame,
      bufferedRanges: stream.cache.ranges(stream.numFrames),
      playing: this.playing,
      waiting: playback.waiting,
      stalls: playback.stalls,
      layers: playback.play.layers,
      rateBps: round.source.rateBps,
      receivedBytes: this.fetcher.receivedBytes,
      decodeMs: this.decodeMs,
    });
  }

  close() {
    this.isClosed = true;
    clearTimeout(this.timer);
    this.#dropNextRound();
    this.scrubber?.end();
    this.round.close();
  }
}
