import { layerOf } from "../format/manifest.js";
import { LayerRule } from "./layerrule.js";

/** Assumed throughput of a link before the first estimate. */
const FIRST_RATE_BPS = 4e6;
/**
 * Requested data in flight beyond what a round trip takes, in seconds of the link: what is needed first
 * comes later by that, so the most needs a buffer.
 */
const LEAST_QUEUE_S = 0.05;
const MOST_QUEUE_S = 0.2;
const QUEUE_BYTES = 32 * 1024;
const STEP_S = 0.1;

/**
 * A request under way. The link is busy with it from `beginsS` on: when its first byte came, or could have.
 * @typedef {{ segment: number, leftBytes: number, abort: AbortController, beginsS: number }} Coming
 */

/** One play of a hosted stream: fetches what the rule chooses into the stream's cache. */
export class HostedPlay {
  /**
   * @param {import("./hosted.js").HostedStream} stream
   * @param {import("./source.js").PlayRequest} wish
   */
  constructor(stream, { firstFrame, mostLayers, nowS }) {
    this.stream = stream;
    this.nowS = nowS;
    this.mostLayers = mostLayers;
    /** @type {Map<string, Coming>} by segment and part */
    this.coming = new Map();
    this.rule = this.#ruleFrom(firstFrame);
    this.nextFrame = firstFrame;
    this.paused = false;
    this.rate = 1;
    this.measuredS = nowS();
    /** Seconds of the last measured time in which the link was busy. */
    this.busyS = 0;
    /** @type {unknown} */
    this.failure = null;
    this.isClosed = false;
    /** Whether nothing more will be requested. */
    this.isDone = false;
    /** @type {() => void} called when data has arrived or a request has failed */
    this.onData = () => {};
  }

  /** Estimated throughput of the link, bits per second; null while unknown. */
  get rateBps() {
    return this.stream.estimator.rateBps;
  }

  /** Least seconds from a request to its first byte; 0 while unknown. */
  get waitS() {
    const { roundTripS } = this.stream.window;
    return roundTripS < Infinity ? roundTripS : 0;
  }

  get isFetching() {
    return this.coming.size > 0;
  }

  /** Number of bytes that were requested and have not arrived. */
  get queuedBytes() {
    let sum = 0;
    for (const { leftBytes } of this.coming.values()) sum += leftBytes;
    return sum;
  }

  /** Amount of requested data in flight, in seconds of the link: a round trip, and less if little is here. */
  get #queueS() {
    const { cache, estimator, manifest, window } = this.stream;
    const first = Math.max(0, this.nextFrame);
    const bufferS = (cache.endOf(first, first + manifest.fps) - first) / manifest.fps;
    const queueS = Math.min(MOST_QUEUE_S, Math.max(LEAST_QUEUE_S, bufferS / 4));
    return queueS + (estimator.rateBps && window.roundTripS < Infinity ? window.roundTripS : 0);
  }

  /** @param {number} firstFrame */
  #ruleFrom(firstFrame) {
    const { cache, manifest, records } = this.stream;
    /** @type {import("./layerrule.js").IsHere} */
    const isHere = ({ segment, numFrames }, part) =>
      cache.hasObject(segment, part, numFrames) || this.coming.has(`${segment}/${part}`);
    return new LayerRule(manifest, records, firstFrame, this.mostLayers, isHere);
  }

  /**
   * @param {number} frame
   * @param {boolean} paused
   * @param {number} rate
   */
  reportPosition(frame, paused, rate) {
    this.nextFrame = frame;
    this.paused = this.stream.isPaused = paused;
    this.rate = rate;
  }

  /**
   * Continues from another frame, see SourcePlay. What is under way is kept, except that a seek waits for
   * no other segment than its own.
   * @param {number} frame
   * @param {import("./source.js").Move} how
   */
  moveTo(frame, how) {
    if (this.isClosed || this.failure !== null) return false;
    if (how === "step") return true;
    const target = this.stream.cache.segmentOf(frame);
    if (how === "seek") this.#abort(({ segment }) => segment !== target);
    this.rule = this.#ruleFrom(frame);
    this.nextFrame = frame;
    return true;
  }

  /**
   * Goes on without a layer of a segment; the next one begins with its snapshot.
   * @param {number} segment
   * @param {number} layer
   * @param {unknown} why
   */
  lose(segment, layer, why) {
    console.warn(`Segment ${segment} lacks layer ${layer}: ${why}`);
    const part = this.rule.lose(segment, layer);
    if (part !== null) this.#fetch(this.stream.records[segment + 1], part);
  }

  /**
   * Goes on without a layer of a segment that was over when an object of it came: the layer begins again
   * with the first snapshot that can be here in time.
   * @param {number} segment
   * @param {number} layer
   */
  #miss(segment, layer) {
    const { cache, manifest, records } = this.stream;
    const soonFrame = this.nextFrame + this.stream.window.waitS * this.rate * manifest.fps;
    const last = Math.max(segment, cache.segmentOf(soonFrame));
    let lost = segment;
    let part = this.rule.lose(lost, layer);
    while (part !== null && lost < last) part = this.rule.lose(++lost, layer);
    if (part !== null) this.#fetch(records[lost + 1], part);
  }

  /** @param {(coming: Coming) => boolean} isUnwanted */
  #abort(isUnwanted) {
    for (const [name, coming] of this.coming) {
      if (!isUnwanted(coming)) continue;
      this.coming.delete(name);
      coming.abort.abort();
    }
  }

  /** Requests the objects that the rule chooses now; returns the maximum seconds until the next call. */
  step() {
    this.#measure();
    if (this.failure !== null) return STEP_S;
    for (;;) {
      const { nextFrame, paused, queuedBytes, rate } = this;
      const { mostRequests, waitS } = this.stream.window;
      const rateBps = this.rateBps ?? FIRST_RATE_BPS;
      this.isDone = false;
      if (this.coming.size >= mostRequests) return STEP_S;
      if (queuedBytes > Math.max(QUEUE_BYTES, (rateBps * this.#queueS) / 8)) return STEP_S;
      const state = { nextFrame, paused, rateBps, queuedBytes, waitS, rate };
      const segment = this.rule.choose(state);
      if (segment === null) {
        this.isDone = this.coming.size === 0 && this.rule.isAtEnd;
        return STEP_S;
      }
      if (!this.stream.cache.hasRoomFor(segment)) return STEP_S;
      const parts = this.rule.parts(segment);
      this.rule.add(segment);
      for (const part of parts) this.#fetch(this.stream.records[segment], part);
    }
  }

  /** Updates the throughput estimate with bytes that arrived now. @param {number} [numBytes] */
  #measure(numBytes = 0) {
    const nowS = this.nowS();
    let restS = 0;
    if (nowS > this.measuredS) {
      const begins = [...this.coming.values()].map(({ beginsS }) => beginsS);
      restS = this.busyS = Math.max(0, nowS - Math.max(this.measuredS, Math.min(...begins)));
      this.measuredS = nowS;
    }
    // Bytes that arrive after a rest of the link say nothing about its rate.
    if (this.busyS > 0) this.stream.estimator.add(numBytes, restS);
  }

  /**
   * @param {import("../format/streamindex.js").SegmentRecord} record
   * @param {import("../format/manifest.js").Part} part
   */
  async #fetch(record, part) {
    const name = `${record.segment}/${part}`;
    const { absent, cache, manifest } = this.stream;
    const layer = layerOf(manifest, part);
    const { rule } = this;
    if (absent.has(name)) return this.lose(record.segment, layer, absent.get(name));
    const abort = new AbortController();
    const leftBytes = this.rule.bytes(record.segment, [part]);
    const askedS = this.nowS();
    const beginsS = askedS + this.stream.window.roundTripS;
    const coming = { segment: record.segment, leftBytes, abort, beginsS };
    this.coming.set(name, coming);
    let isFirst = true;
    const count = (/** @type {number} */ numBytes) => {
      coming.leftBytes -= numBytes;
      if (numBytes > 0) this.#measure(numBytes); // what broke off has come, too
      if (isFirst) {
        const tookS = this.nowS() - askedS;
        coming.beginsS = Math.min(coming.beginsS, askedS + tookS);
        this.stream.window.addFirstByte(tookS);
      }
      isFirst = false;
      this.onData();
    };
    try {
      const packets = await this.stream.object(record, part, count, abort.signal);
      cache.addObject(record, part, packets);
      const isLate = this.nextFrame >= record.firstFrame + record.numFrames;
      if (isLate && layer > 0 && rule === this.rule) this.#miss(record.segment, layer);
    } catch (error) {
      if (abort.signal.aborted) return;
      if (layer === 0) this.failure ??= error;
      else if (this.failure === null) {
        absent.set(name, error);
        this.lose(record.segment, layer, error);
      }
    }
    if (this.coming.get(name) === coming) this.coming.delete(name);
    this.onData();
  }

  close() {
    this.isClosed = true;
    this.onData = () => {};
    this.#abort(() => true);
  }
}
