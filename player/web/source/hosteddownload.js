/** The download of whole objects from a static host into the cache, and the measurement of its link. */

import { isKeyframe, layerOf } from "../format/manifest.js";
import { LayerRule } from "./layerrule.js";
import { isWhole } from "./segmentcache.js";

/** @typedef {import("../format/manifest.js").Part} Part */
/** @typedef {import("./segmentcache.js").SegmentCache} SegmentCache */

const EMPTY = new Uint8Array(0);

/**
 * Adds the packets of an object; a frame without a packet counts as unchanged.
 * @param {SegmentCache} cache
 * @param {Pick<import("../format/objects.js").SegmentRecord, "firstFrame" | "numFrames">} record @param {Part} part
 * @param {Map<number, Uint8Array>} packets by birth
 */
export function addObject(cache, { firstFrame, numFrames }, part, packets) {
  const isOne = isKeyframe(cache, part);
  for (let birth = firstFrame; birth < firstFrame + (isOne ? 1 : numFrames); birth++) {
    const packet = packets.get(birth) ?? (isOne ? null : EMPTY);
    if (packet !== null) cache.add(birth, part, packet);
  }
}

/**
 * Whether all packets of an object are cached.
 * @param {SegmentCache} cache @param {number} segment @param {Part} part @param {number} numFrames of the segment
 */
export function hasObject(cache, segment, part, numFrames) {
  const row = cache.segments.get(segment)?.rows[part];
  return row !== undefined && isWhole(row, 0, isKeyframe(cache, part) ? 1 : numFrames);
}

/** Busy seconds after which a measurement counts half. */
const HALF_LIFE_S = 0.4;
/** Minimum amount of data for an estimate. */
const LEAST_BYTES = 16 * 1024;
/** Sooner answers come from a cache, or from a host so near that the round trip does not matter. */
const LEAST_ROUND_TRIP_S = 0.02;
/** Requests under way at a time: what a browser sends at once over HTTP/1.1, and what HTTP/2 takes. */
const LEAST_REQUESTS = 6;
/** Over HTTP/2 they come back at once, and more may follow soon. */
const FIRST_REQUESTS = 9;
const MOST_REQUESTS = 100;
/** A first byte that takes so many round trips has waited for other requests. */
const QUICK_ROUND_TRIPS = 1.5;
/** Weight of one more request in the mean time to a first byte. */
const WEIGHT = 1 / 4;

/** Estimates a connection's throughput: bytes over busy time, with exponentially decaying weights. */
export class RateEstimator {
  /** @type {number | null} bits per second; null until enough data has arrived */
  rateBps = null;
  bytes = 0;
  busyS = 0;
  /** Whether enough bytes of the connection have arrived. */
  isKnown = false;

  /**
   * Adds the bytes that arrived during `busyS` seconds with data in flight.
   * @param {number} bytes @param {number} busyS
   */
  add(bytes, busyS) {
    const kept = 0.5 ** (busyS / HALF_LIFE_S);
    this.bytes = kept * this.bytes + bytes;
    this.busyS = kept * this.busyS + busyS;
    this.isKnown ||= this.bytes >= LEAST_BYTES;
    if (this.isKnown && this.busyS > 0) this.rateBps = Math.max(1, (8 * this.bytes) / this.busyS);
  }

  /**
   * Takes the weight of bytes that did not cross the connection. The rate stays until others have come: the
   * rest of what is cached arrives as fast.
   * @param {number} bytes
   */
  remove(bytes) {
    const kept = Math.max(0, 1 - bytes / Math.max(1, this.bytes));
    this.bytes *= kept;
    this.busyS *= kept;
    this.isKnown = this.bytes >= LEAST_BYTES;
  }
}

/**
 * Reports the responses whose bodies came from the browser's cache. Those of another origin are known only
 * if its host sends `Timing-Allow-Origin`.
 * @param {(numBytes: number) => void} onCached
 */
export function watchCache(onCached) {
  new PerformanceObserver((list) => {
    for (const entry of list.getEntries()) {
      const { transferSize, encodedBodySize } = /** @type {PerformanceResourceTiming} */ (entry);
      if (transferSize < encodedBodySize) onCached(encodedBodySize);
    }
  }).observe({ type: "resource" });
}

/**
 * How far away a host is, and how many requests it answers side by side. More of them would wait in the
 * browser, where what has been chosen too early cannot be chosen again; so their number grows only while
 * first bytes come quickly.
 */
export class RequestWindow {
  /** Least time to a first byte, seconds. */
  roundTripS = Infinity;
  /** Mean of late, seconds. */
  waitS = 0;
  /** Requests that may be under way. */
  mostRequests = FIRST_REQUESTS;

  /** @param {number} tookS seconds from a request to its first byte */
  addFirstByte(tookS) {
    if (tookS > LEAST_ROUND_TRIP_S) this.roundTripS = Math.min(this.roundTripS, tookS);
    this.waitS += WEIGHT * (tookS - this.waitS);
    const isQuick = tookS < QUICK_ROUND_TRIPS * this.roundTripS;
    const most = this.mostRequests + (isQuick ? 1 : -1);
    this.mostRequests = Math.min(Math.max(most, LEAST_REQUESTS), MOST_REQUESTS);
  }
}

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
export class HostedDownload {
  /** @type {Map<string, Coming>} by segment and part */
  coming = new Map();
  paused = false;
  rate = 1;
  /** Seconds of the last measured time in which the link was busy. */
  busyS = 0;
  /** @type {unknown} */
  failure = null;
  isClosed = false;
  /** Whether nothing more will be requested. */
  isDone = false;
  /** @type {() => void} called when data has arrived or a request has failed */
  onData = () => {};

  /** @param {import("./hosted.js").HostedStream} stream @param {import("./source.js").PlayRequest} wish */
  constructor(stream, { firstFrame, mostLayers, nowS }) {
    this.stream = stream;
    /** @type {() => number} */ this.nowS = nowS;
    /** @type {number} */ this.mostLayers = mostLayers;
    /** @type {LayerRule} */ this.rule = this.#ruleFrom(firstFrame);
    /** @type {number} */ this.nextFrame = firstFrame;
    /** @type {number} */ this.measuredS = nowS();
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
      hasObject(cache, segment, part, numFrames) || this.coming.has(`${segment}/${part}`);
    return new LayerRule(manifest, records, firstFrame, this.mostLayers, isHere);
  }

  /** @param {number} frame @param {boolean} paused @param {number} rate */
  reportPosition(frame, paused, rate) {
    this.nextFrame = frame;
    this.paused = this.stream.isPaused = paused;
    this.rate = rate;
  }

  /**
   * Continues from another frame, see SourcePlay. What is under way is kept, except that a seek waits for
   * no other segment than its own.
   * @param {number} frame @param {import("./source.js").Move} how
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
   * Goes on without a layer of a segment; the next one begins with its keyframe.
   * @param {number} segment @param {number} layer @param {unknown} why
   */
  lose(segment, layer, why) {
    console.warn(`Segment ${segment} lacks layer ${layer}: ${why}`);
    const part = this.rule.lose(segment, layer);
    if (part !== null) this.#fetch(this.stream.records[segment + 1], part);
  }

  /**
   * Goes on without a layer of a segment that was over when an object of it came: the layer begins again
   * with the first keyframe that can be here in time.
   * @param {number} segment @param {number} layer
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
   * @param {import("../format/objects.js").SegmentRecord} record @param {import("../format/manifest.js").Part} part
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
      addObject(cache, record, part, packets);
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
