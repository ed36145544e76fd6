import { RateEstimator } from "./estimator.js";
import { LayerRule } from "./layerrule.js";

/** Assumed throughput of a link before the first estimate. */
const FIRST_RATE_BPS = 4e6;
/** Maximum amount of requested data in flight, in seconds of the link. */
const QUEUE_S = 0.2;
const QUEUE_BYTES = 32 * 1024;
const STEP_S = 0.1;

/** One play of a hosted stream: fetches what the rule chooses into the stream's cache. */
export class HostedPlay {
  /**
   * @param {import("./hosted.js").HostedStream} stream
   * @param {import("./source.js").PlayRequest} wish
   */
  constructor(stream, { firstFrame, mostLayers, nowS }) {
    this.stream = stream;
    this.nowS = nowS;
    const { cache, manifest, records } = stream;
    /** @type {import("./layerrule.js").IsHere} */
    const isHere = ({ segment, numFrames }, part) => cache.hasObject(segment, part, numFrames);
    this.rule = new LayerRule(manifest, records, firstFrame, mostLayers, isHere);
    this.abort = new AbortController();
    this.estimator = new RateEstimator();
    this.nextFrame = firstFrame;
    this.paused = false;
    this.rate = 1;
    this.queuedBytes = 0;
    this.comeBytes = 0;
    this.measuredS = nowS();
    /** @type {unknown} */
    this.failure = null;
    this.isClosed = false;
    /** Number of objects that were requested and have not arrived. */
    this.underway = 0;
    /** Whether nothing more will be requested. */
    this.isDone = false;
    /** @type {() => void} called when data has arrived or a request has failed */
    this.onData = () => {};
  }

  /** Estimated throughput of the link, bits per second; null while unknown. */
  get rateBps() {
    return this.estimator.rateBps ?? this.stream.rateBps;
  }

  /**
   * @param {number} frame
   * @param {boolean} paused
   * @param {number} rate
   */
  reportPosition(frame, paused, rate) {
    this.nextFrame = frame;
    this.paused = paused;
    this.rate = rate;
  }

  /**
   * Continues from another frame, see SourcePlay.
   * @param {number} frame
   * @param {boolean} isStep
   */
  moveTo(frame, isStep) {
    // A join may need further objects, which only a new play requests.
    return isStep && frame >= this.nextFrame;
  }

  /** Requests the objects that the rule chooses now; returns the maximum seconds until the next call. */
  step() {
    this.#measure();
    for (;;) {
      const { nextFrame, paused, queuedBytes, rate } = this;
      const rateBps = this.rateBps ?? FIRST_RATE_BPS;
      this.isDone = false;
      if (queuedBytes > Math.max(QUEUE_BYTES, (rateBps * QUEUE_S) / 8)) return STEP_S;
      const segment = this.rule.choose({ nextFrame, paused, rateBps, queuedBytes, rate });
      if (segment === null) {
        this.isDone = this.underway === 0 && this.rule.isAtEnd;
        return STEP_S;
      }
      if (!this.stream.cache.hasRoomFor(segment)) return STEP_S;
      const parts = this.rule.parts(segment);
      this.queuedBytes += this.rule.bytes(segment, parts);
      this.rule.add(segment);
      for (const part of parts) this.#fetch(this.stream.records[segment], part);
    }
  }

  /** Updates the throughput estimate with the bytes that arrived since the last call. */
  #measure() {
    const nowS = this.nowS();
    if (this.queuedBytes > 0 || this.comeBytes > 0) {
      this.estimator.add(this.comeBytes, nowS - this.measuredS);
      this.queuedBytes -= this.comeBytes;
      this.comeBytes = 0;
    }
    this.measuredS = nowS;
  }

  /**
   * @param {import("../format/streamindex.js").SegmentRecord} record
   * @param {string} part
   */
  async #fetch(record, part) {
    const { cache } = this.stream;
    const count = (/** @type {number} */ numBytes) => {
      this.comeBytes += numBytes;
      this.onData();
    };
    this.underway += 1;
    try {
      const packets = await this.stream.object(record, part, count, this.abort.signal);
      cache.addObject(record, part, packets);
    } catch (error) {
      if (!this.isClosed) this.failure ??= error;
    }
    this.underway -= 1;
    this.onData();
  }

  close() {
    this.isClosed = true;
    this.onData = () => {};
    this.abort.abort();
    this.stream.rateBps = this.rateBps;
  }
}
