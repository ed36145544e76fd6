import { ESTIMATOR_CONFIG, RateEstimator } from "./estimator.js";
import { Outlook } from "./outlook.js";
import { leastFrames, PLAYOUT_CONFIG, PlayoutClock } from "./playoutclock.js";
import { SliceHolding } from "./sliceholding.js";
import { SliceSweep } from "./slicesweep.js";
import { SlotHolding } from "./slotholding.js";
import { SlotSweep } from "./slotsweep.js";

/** How far ahead of what shows a play is kept; server/abr/session.py says what each number means. */
export const SESSION_CONFIG = {
  maxLeadS: 6,
  queueS: 0.1,
  runS: 0.02,
  restS: 0.1,
  firstRateBps: 4e6,
  firstBytes: 32 * 1024,
  playout: PLAYOUT_CONFIG,
  estimator: ESTIMATOR_CONFIG,
};

/** @typedef {typeof SESSION_CONFIG} SessionConfig */

/**
 * What to do now: ask for something; wait until more has come; wait until a time, unless something
 * comes; look for new frames of a live stream; or nothing more.
 * @typedef {import("./outlook.js").Send
 *   | { kind: "waitForNews" }
 *   | { kind: "waitUntil", timeS: number }
 *   | { kind: "waitForFrames" }
 *   | { kind: "finished" }} Decision
 */

/**
 * @typedef {object} Underway
 * @property {number} endByte bytes that were asked for with it, of all
 * @property {number} endFrame the first frame that cannot show once it has come
 * @property {number} sentS
 */

/**
 * One play of a stream: what is asked for next, and when (server/abr/session.py). Whoever sends, a
 * server or a client that fetches from one, runs the same rules. It reads no clock.
 */
export class PlaySession {
  /**
   * @param {import("./media.js").Media} media
   * @param {number} nowS
   * @param {object} [options]
   * @param {number} [options.firstFrame]
   * @param {number | null} [options.untilFrame]
   * @param {number | null} [options.rateBps] what is known of the link from an earlier play
   * @param {SessionConfig} [options.config]
   */
  constructor(media, nowS, options = {}) {
    const { firstFrame = 0, untilFrame = null, rateBps = null, config = SESSION_CONFIG } = options;
    this.media = media;
    this.config = config;
    this.untilFrame = untilFrame;
    this.estimator = new RateEstimator(config.estimator);
    this.firstRateBps = rateBps || config.firstRateBps;
    this.isKnown = rateBps !== null;
    /** @type {(outlook: Outlook) => import("./outlook.js").Send | null} */
    this.choose = () => null;
    /** @type {SliceHolding | SlotHolding} what is here, or underway */
    this.holding = this.#open(firstFrame);
    this.clock = new PlayoutClock(firstFrame, media.fps, config.playout, this.#lastFrame());
    /** The first frame that had not shown at the last decision. */
    this.nextFrame = firstFrame;
    this.oldestFrame = firstFrame; // what lies before is forgotten
    this.sentBytes = 0;
    this.ackedBytes = 0;
    this.newsS = nowS;
    this.cameS = nowS; // when something came last
    this.countedS = nowS; // up to when time was counted, as busy or as idle
    this.begins = true; // whether the link had nothing to carry before what comes next
    /** @type {Underway[]} */
    this.underway = [];
    /** @type {number | null} from the asking to the first byte, over an idle link */
    this.leastLatencyS = null;
    this.resting = false;
    /** @type {number | null} what a paused playback will show next */
    this.pausedFrame = null;
  }

  /** @param {number} firstFrame */
  #open(firstFrame) {
    if (this.media.hasSlots) {
      const holding = new SlotHolding(this.media, firstFrame);
      const policy = new SlotSweep();
      this.choose = (outlook) => policy.choose(outlook, holding);
      return holding;
    }
    const holding = new SliceHolding(this.media, firstFrame);
    const policy = new SliceSweep();
    this.choose = (outlook) => policy.choose(outlook, holding);
    return holding;
  }

  /** The estimated throughput, bits per second; null until there is one. */
  get rateBps() {
    return this.estimator.rateBps;
  }

  /** Asked for, but not here; less than a byte is what adding up parts of bytes leaves. */
  get queuedBytes() {
    const queuedBytes = this.sentBytes - this.ackedBytes;
    return queuedBytes >= 0.5 ? queuedBytes : 0;
  }

  /** The first frame that never comes; null while it is not known. */
  #lastFrame() {
    const { live, numFrames } = this.media;
    if (this.untilFrame !== null && (!live || this.untilFrame <= numFrames)) {
      return Math.min(this.untilFrame, numFrames);
    }
    return live ? null : numFrames;
  }

  /**
   * Of all that was asked for, `ackedBytes` have come.
   * @param {number} nowS
   * @param {number} ackedBytes
   */
  acknowledge(nowS, ackedBytes) {
    this.#holdClock(nowS);
    const gone = ackedBytes - this.ackedBytes;
    if (this.queuedBytes > 0) this.#measure(nowS, gone);
    this.ackedBytes = Math.max(this.ackedBytes, ackedBytes);
    this.newsS = nowS;
    if (gone > 0) this.cameS = nowS;
    while (this.underway.length > 0 && this.underway[0].endByte < this.ackedBytes + 0.5) {
      const [{ endFrame }] = this.underway.splice(0, 1);
      this.clock.readyUntil(endFrame, nowS);
    }
  }

  /**
   * The playback says where it is.
   * @param {number} nowS
   * @param {number} frame the next one that it will show
   * @param {boolean} paused whether its time stands still
   */
  told(nowS, frame, paused) {
    this.clock.told(frame, nowS);
    this.pausedFrame = paused ? this.clock.nextFrame(nowS) : null;
  }

  /** Keeps the clock of a paused playback where it is. @param {number} nowS */
  #holdClock(nowS) {
    if (this.pausedFrame !== null) this.clock.told(this.pausedFrame, nowS);
  }

  /**
   * Adds a sample, of the time in which the link had something to carry. The first news behind a
   * pause takes the latency and the time of as many bytes as come with it, and nobody knows what of
   * each: what counts begins behind it.
   * @param {number} nowS
   * @param {number} goneBytes
   */
  #measure(nowS, goneBytes) {
    const { sentS } = this.underway[0];
    let sinceS = this.newsS;
    if (this.leastLatencyS === null || sentS + this.leastLatencyS > sinceS) this.begins = true;
    if (this.begins) {
      if (goneBytes <= 0) return;
      this.begins = false;
      const tookS = nowS - sentS;
      this.leastLatencyS = Math.min(tookS, this.leastLatencyS || tookS);
      // It carries at least what came since something came, pauses and all.
      sinceS = this.cameS;
      if (8 * goneBytes <= (this.rateBps || Infinity) * (nowS - sinceS)) return;
    }
    this.estimator.add(goneBytes, nowS - sinceS, Math.max(0, sinceS - this.countedS));
    this.countedS = nowS;
  }

  /**
   * Something was asked for, of `numBytes` bytes.
   * @param {import("./outlook.js").Send} send
   * @param {number} numBytes
   * @param {number} nowS
   */
  sent(send, numBytes, nowS) {
    if (send.kind === "slices") {
      for (let birth = send.birth; birth < send.endBirth; birth++) {
        this.holding.add(birth, send.firstLayer, send.endLayer);
      }
    } else {
      this.holding.addSnapshots(send.frame, send.firstLayer, send.endLayer);
    }
    this.sentBytes += numBytes;
    this.underway.push({
      endByte: this.sentBytes,
      endFrame: this.holding.endFrame,
      sentS: nowS,
    });
  }

  /** How many frames may be asked for ahead. */
  get #leadFrames() {
    const { playout, maxLeadS } = this.config;
    const { fps } = this.media;
    return Math.max(leastFrames(playout, fps), roundHalfToEven(maxLeadS * fps));
  }

  /**
   * What to do now.
   * @param {number} nowS
   * @returns {Decision}
   */
  decide(nowS) {
    const { media, clock, config } = this;
    this.#holdClock(nowS);
    const lastFrame = this.#lastFrame();
    if (clock.untilFrame !== lastFrame) {
      clock.untilFrame = lastFrame;
      clock.readyUntil(clock.endFrame, nowS); // a lead that never comes is not waited for
    }
    if (media.numFrames === 0) return { kind: media.live ? "waitForFrames" : "finished" };
    if (this.queuedBytes >= this.#allowedBytes()) return { kind: "waitForNews" };
    const nextFrame = clock.nextFrame(nowS);
    this.nextFrame = nextFrame;
    if (lastFrame !== null && nextFrame >= lastFrame) return { kind: "finished" };
    clock.forget(nextFrame);
    // A playback that is further behind than it seemed gets no more of what was forgotten.
    this.oldestFrame = Math.max(this.oldestFrame, nextFrame);
    this.holding.forget(this.oldestFrame);
    const numFrames = lastFrame ?? media.numFrames;
    const endBirth = Math.min(numFrames, nextFrame + this.#leadFrames);
    const outlook = this.#outlook(nowS, endBirth);
    const isFull = endBirth < numFrames;
    // A playback that turned out to be further behind may hold more than the lead.
    const shown = Math.max(0, endBirth - this.holding.endFrame);
    const restsS = config.restS - shown / media.fps;
    const waits = clock.startedS === null || clock.isStalled(nowS);
    const timeS = nowS + Math.max(1 / media.fps, restsS);
    if (this.resting && isFull && restsS > 0 && !waits) return { kind: "waitUntil", timeS };
    const send = this.choose(outlook);
    this.resting = send === null;
    if (send !== null) return send;
    if (isFull) return { kind: "waitUntil", timeS };
    if (lastFrame === null) return { kind: "waitForFrames" };
    // What lacks may be worth asking for later, as long as it shows.
    if (!this.holding.isComplete(this.oldestFrame, lastFrame)) {
      return { kind: "waitUntil", timeS: nowS + 1 / media.fps };
    }
    return { kind: "finished" };
  }

  /**
   * @param {number} nowS
   * @param {number} endBirth
   */
  #outlook(nowS, endBirth) {
    return new Outlook({
      media: this.media,
      clock: this.clock,
      nowS,
      rateBps: this.rateBps || this.firstRateBps,
      measured: this.rateBps !== null || this.isKnown,
      queuedBytes: this.queuedBytes,
      latencyS: this.leastLatencyS || 0,
      nextFrame: this.oldestFrame,
      endBirth,
      runS: this.config.runS,
      paused: this.pausedFrame !== null,
    });
  }

  /** How much may be on its way. */
  #allowedBytes() {
    const { queueS, firstBytes } = this.config;
    if (this.rateBps === null) {
      const known = this.isKnown ? (this.firstRateBps * queueS) / 8 : 0;
      return Math.max(known, firstBytes + this.ackedBytes);
    }
    return Math.max(firstBytes, (this.rateBps * (queueS + (this.leastLatencyS || 0))) / 8);
  }
}

/** Rounded as Python does. @param {number} x */
function roundHalfToEven(x) {
  const below = Math.floor(x);
  const rest = x - below;
  if (rest !== 0.5) return Math.round(x);
  return below % 2 === 0 ? below : below + 1;
}
