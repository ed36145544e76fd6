import { corrupt } from "../format/bytes.js";
import { skipMapsOf, keyframeOf } from "../format/manifest.js";
import { SILENT } from "./fetcher.js";
import { GoneError, openPlay, ServerRetry } from "./playresponse.js";
import { AHEAD_S } from "./segmentcache.js";

/** Seconds between two status reports to the server. */
const REPORT_S = 1;

/** @typedef {import("./served.js").ServedStream} ServedStream */
/** @typedef {import("./playresponse.js").PlayResponse} PlayResponse */

/**
 * Frames that the cache lacks.
 * @typedef {object} Gap
 * @property {number} fromFrame the first frame to request from the server
 * @property {number | undefined} untilFrame the first frame after the gap that is cached
 * @property {number[]} keyframes layers, if only their keyframes are missing in the segment
 */

/**
 * One play of a swings server: requests the frames that the cache lacks, as far ahead as the cache can
 * hold them, and again if the connection breaks.
 */
export class ServedDownload {
  paused = false;
  reportedS = -Infinity;
  /** Whether the answer to a report is awaited. */
  isReporting = false;
  reportTimer = 0;
  /** @type {number | null} the server's estimate of the link's throughput */
  rateBps = null;
  /** @type {unknown} */
  failure = null;
  isClosed = false;
  /** Whether nothing more will be requested. */
  isDone = false;
  /** @type {() => void} called when data has arrived or a request has failed */
  onData = () => {};
  abort = new AbortController();
  /** @type {PlayResponse | null} */
  response = null;
  moveOn = () => {};

  /** @param {ServedStream} stream @param {import("./source.js").PlayRequest} request */
  constructor(stream, { firstFrame, mostLayers, nowS }) {
    /** @type {ServedStream} */ this.stream = stream;
    /** @type {number} */ this.mostLayers = mostLayers;
    /** @type {() => number} */ this.nowS = nowS;
    /** @type {number} */ this.firstFrame = firstFrame;
    /** End of the range of frames that were found in the cache, or were sent. @type {number} */
    this.endBirth = firstFrame;
    /** @type {number} */ this.nextFrame = firstFrame;
    this.patience = new ServerRetry(stream.fetcher, stream.base);
    // Deferred, so that the caller can report the position first.
    Promise.resolve()
      .then(() => this.#run())
      .catch((/** @type {unknown} */ error) => this.#fail(error));
  }

  /** @param {unknown} error */
  #fail(error) {
    if (this.isClosed) return;
    this.failure = error;
    this.onData();
  }

  get isFetching() {
    return this.response !== null;
  }

  step() {
    return REPORT_S;
  }

  /**
   * Forwards the position to the server, at most once a second at normal speed.
   * @param {number} frame @param {boolean} paused @param {number} rate
   */
  reportPosition(frame, paused, rate) {
    // Before its first frame, a play counts as paused there.
    const isEarly = frame < 0;
    const isPaused = paused || isEarly;
    this.nextFrame = isEarly ? this.firstFrame : frame;
    this.moveOn();
    const periodS = REPORT_S / Math.max(1, rate);
    if (isPaused === this.paused && this.nowS() - this.reportedS < periodS) return;
    this.paused = isPaused;
    this.#postReport();
  }

  /** Reports what has come as often as the server wants to know it, where it measures by that. */
  #reportReceived() {
    const { response } = this;
    if (!response?.reportMs || response.points.length === 0 || this.isReporting) return;
    clearTimeout(this.reportTimer);
    const waitMs = response.reportMs - 1000 * (this.nowS() - this.reportedS);
    if (waitMs <= 0) this.#postReport();
    // The server may wait for this report before it sends anything more.
    else this.reportTimer = setTimeout(() => this.#reportReceived(), waitMs);
  }

  async #postReport() {
    const { response, stream } = this;
    this.reportedS = this.nowS();
    if (!response?.token) return;
    const received = response.takePoints();
    const body = JSON.stringify({ frame: this.nextFrame, paused: this.paused, received });
    this.isReporting = true;
    const silence = new AbortController();
    const stop = stream.fetcher.watch(() => {
      silence.abort();
      this.patience.why = SILENT;
      response.close(); // so that the play is opened again
    });
    try {
      const url = `${stream.base}play/${response.token}`;
      const { signal } = silence;
      const { headers } = await stream.fetcher.send(url, { method: "POST", body, signal });
      const rateBps = Number(headers.get("Swings-Rate"));
      if (rateBps > 0) this.rateBps = stream.rateBps = rateBps;
      response.reportMs = Number(headers.get("Swings-Report-Ms"));
      // More than what was sent: a play goes a few seconds ahead, and no further while it is paused.
      const numFrames = Number(headers.get("Swings-Frames"));
      if (numFrames > 0) stream.grow(numFrames, headers.get("Swings-Live") === "1");
    } catch (error) {
      // If the server is unreachable, the response breaks off as well, which is reported.
      console.debug(`A report of the position did not arrive: ${error}`);
    }
    stop();
    this.isReporting = false;
    this.#reportReceived();
  }

  /** Continues from another frame, see SourcePlay. @param {number} frame @param {import("./source.js").Move} how */
  moveTo(frame, how) {
    const { stream, mostLayers, firstFrame, endBirth } = this;
    const { cache } = stream;
    if (this.isClosed || this.failure !== null || how === "loop") return false;
    if (frame < firstFrame || frame >= endBirth) return false;
    const segment = cache.segmentOf(frame);
    const isHere = cache.hasAllChanges(segment, stream.framesIn(segment), mostLayers);
    const missing = how === "step" ? [] : cache.missingKeyframes(segment, mostLayers);
    if (!isHere) return false;
    for (let next = segment + 1; next < cache.segmentOf(endBirth); next++) {
      if (!cache.isComplete(next, stream.framesIn(next), mostLayers)) return false;
    }
    this.#fetchKeyframes(segment, missing).catch((error) => this.#fail(error));
    return true;
  }

  async #run() {
    const { stream, patience } = this;
    while (!this.isClosed) {
      const gap = this.#findGap();
      const wasDone = this.isDone;
      this.isDone = gap === null;
      if (gap === null || !this.#isNear(gap)) {
        // Who hears this reports the position, for which this waits.
        if (this.isDone !== wasDone) this.onData();
        await this.#position();
        continue;
      }
      if (gap.keyframes.length > 0) {
        await this.#fetchKeyframes(this.#segmentOf(gap.fromFrame), gap.keyframes);
        continue;
      }
      const { endBirth } = this;
      this.response = await this.#open(gap);
      if (this.isClosed) this.response.close();
      this.reportedS = -Infinity; // so that the next report goes to this response
      try {
        if (await this.#receiveAll(this.response, gap)) {
          patience.reset();
          // Parts of these frames that the server left out are not requested again in this play.
          this.endBirth = Math.max(endBirth, gap.untilFrame ?? stream.numFrames);
          continue;
        }
      } catch (error) {
        if (!(error instanceof GoneError)) throw error;
        patience.why = error.message;
      } finally {
        stream.lastToken = this.response.token;
        this.response = null;
      }
      if (this.isClosed) return;
      // A server that answers and then breaks off may do so every time, so tries without progress count.
      if (this.endBirth > endBirth) patience.reset();
      else await patience.wait();
    }
  }

  /** The first missing frames from `endBirth` on; null if there are none. @returns {Gap | null} */
  #findGap() {
    const { stream, firstFrame } = this;
    const { cache, numFrames, manifest } = stream;
    for (;;) {
      if (this.endBirth >= numFrames) {
        if (!manifest.live) return null;
        return { fromFrame: numFrames - 1, untilFrame: undefined, keyframes: [] };
      }
      const segment = this.#segmentOf(this.endBirth);
      const start = segment * manifest.segmentFrames;
      const size = stream.framesIn(segment);
      const isJoin = this.#isJoin(segment);
      const keyframes = this.#missingKeyframes(segment);
      const isHere = this.#hasChanges(segment);
      if (isHere && keyframes.length === 0) {
        this.endBirth = start + size;
        continue;
      }
      // A play that begins with a segment gets a keyframe; it needs no first slice, and is sent none.
      const first = isJoin ? firstFrame : start;
      const hasBase = !isJoin || cache.keyframe(segment, 0) !== null;
      const end = hasBase ? cache.endOf(isJoin ? start : first, start + size) : first;
      const fromFrame = end < start + size ? Math.max(first, end - 1) : first;
      return { fromFrame, untilFrame: this.#endOfGap(segment), keyframes: isHere ? keyframes : [] };
    }
  }

  /**
   * The next frame after a segment that need not be sent, because it is cached, or too far ahead for a still picture.
   * @param {number} segment
   */
  #endOfGap(segment) {
    const { stream, mostLayers, paused } = this;
    if (stream.manifest.live) return undefined;
    for (let next = segment + 1; stream.framesIn(next) > 0; next++) {
      const isHere = stream.cache.isComplete(next, stream.framesIn(next), mostLayers);
      if (isHere || (paused && next > segment + 1)) return next * stream.manifest.segmentFrames;
    }
    return undefined;
  }

  /** Whether to request a gap now; a paused play needs only its own segment. @param {Gap} gap */
  #isNear({ fromFrame }) {
    const { stream, nextFrame } = this;
    if (this.#segmentOf(fromFrame) <= this.#segmentOf(nextFrame)) return true;
    // A live stream is also requested during a pause: only a play shows that it grows.
    const isWanted = !this.paused || stream.manifest.live;
    const hasRoom = stream.cache.hasRoomFor(this.#segmentOf(fromFrame));
    return isWanted && hasRoom && fromFrame <= nextFrame + this.#mostAhead;
  }

  get #mostAhead() {
    return AHEAD_S * this.stream.manifest.fps;
  }

  /** @param {number} frame */
  #segmentOf(frame) {
    return this.stream.cache.segmentOf(frame);
  }

  /** Fetches the keyframes of some layers, layer 0 first. @param {number} segment @param {number[]} layers */
  async #fetchKeyframes(segment, layers) {
    const { stream, abort } = this;
    for (const layer of layers) {
      try {
        await stream.fetchKeyframe(segment, layer, abort.signal);
      } catch (error) {
        if (this.isClosed) return;
        throw error;
      }
      this.onData();
    }
  }

  /** Opens a response with the frames of a gap. @param {Gap} gap */
  async #open({ fromFrame, untilFrame }) {
    const { stream, mostLayers } = this;
    const { first, base, lastToken, rateBps } = stream;
    stream.first = null;
    const layers = mostLayers < stream.manifest.numLayers ? mostLayers : null;
    if (first !== null && fromFrame === 0 && layers === null && untilFrame === undefined)
      return first;
    first?.close();
    const paused = this.paused && fromFrame === this.nextFrame;
    // Without this, the server would count the cached frames as missing, and send a whole lead after them.
    const nextFrame = fromFrame > this.nextFrame ? this.nextFrame : null;
    const query = { fromFrame, untilFrame, layers, lastToken, rateBps, paused, nextFrame };
    const { signal } = this.abort;
    const { response, start } = await this.patience.begin(() =>
      openPlay(stream.fetcher, base, query, signal),
    );
    stream.checkSame(start.manifest);
    stream.grow(start.numFrames, stream.manifest.live);
    return response;
  }

  /**
   * Puts all records of a response into the cache; returns whether the response was complete.
   * @param {PlayResponse} response @param {Gap} gap
   */
  async #receiveAll(response, gap) {
    const { stream } = this;
    for (;;) {
      const record = await response.next(() => stream.count(response));
      this.#reportReceived();
      if (this.isClosed || record === null) return false;
      if (record.kind === "end") {
        if (gap.untilFrame === undefined) stream.grow(record.numFrames, false);
        this.onData();
        return true;
      }
      if (record.kind === "error") {
        this.patience.noteReport(record.message);
        return false;
      }
      if (record.kind !== "start") this.#cacheRecord(record);
      this.onData();
      await this.#room();
    }
  }

  /** @param {import("../constants.js").SliceRecord | import("../constants.js").KeyframeRecord} record */
  #cacheRecord(record) {
    const { manifest, cache } = this.stream;
    const isKeyframe = record.kind === "keyframe";
    const birth = isKeyframe ? record.frame : record.birth;
    // A record far ahead of layer 0 is useless, and would stay in the cache.
    if (birth < 0 || birth > this.endBirth + manifest.segmentFrames)
      throw corrupt(`play: the slice born at ${birth} arrived, but birth ${this.endBirth} is next`);
    if (!isKeyframe && record.skipMap !== null)
      cache.add(birth, skipMapsOf(manifest), record.skipMap);
    for (const [n, packet] of record.packets.entries()) {
      const layer = record.firstLayer + n;
      if (layer >= manifest.numLayers)
        throw corrupt(
          `play: a packet of layer ${layer}, but the stream has ${manifest.numLayers} layers`,
        );
      cache.add(birth, isKeyframe ? keyframeOf(manifest, layer) : layer, packet);
    }
    if (isKeyframe || record.firstLayer > 0) return;
    this.endBirth = Math.max(this.endBirth, birth + 1);
    this.stream.grow(this.endBirth, manifest.live);
  }

  /** Waits while too much data is cached that has not shown yet. */
  async #room() {
    const { cache, manifest } = this.stream;
    const isFar = () =>
      this.endBirth > this.nextFrame + this.#mostAhead + manifest.segmentFrames ||
      (!this.#isRefining && !cache.hasRoomFor(this.#segmentOf(this.endBirth)));
    while (!this.isClosed && isFar()) await this.#position();
  }

  /** Whether layers of a still picture are missing; they may arrive after later frames. */
  get #isRefining() {
    if (!this.paused) return false;
    const segment = this.#segmentOf(this.nextFrame);
    return !this.#hasChanges(segment) || this.#missingKeyframes(segment).length > 0;
  }

  /** Whether all changes of a segment that this play needs are cached. @param {number} segment */
  #hasChanges(segment) {
    const { stream, mostLayers } = this;
    const size = stream.framesIn(segment);
    return this.#isJoin(segment)
      ? stream.cache.hasAllChanges(segment, size, mostLayers)
      : stream.cache.isComplete(segment, size, mostLayers);
  }

  /** Layers whose keyframes this play needs but lacks. @param {number} segment */
  #missingKeyframes(segment) {
    const { cache } = this.stream;
    return this.#isJoin(segment) ? cache.missingKeyframes(segment, this.mostLayers) : [];
  }

  /** Whether this play begins in a segment. @param {number} segment */
  #isJoin(segment) {
    return segment === this.#segmentOf(this.firstFrame);
  }

  /** Resolves at the next report of the position, or when the play is closed. */
  #position() {
    return new Promise((resolve) => (this.moveOn = () => resolve(undefined)));
  }

  close() {
    this.isClosed = true;
    clearTimeout(this.reportTimer);
    this.onData = () => {};
    this.patience.isOver = true;
    this.moveOn();
    this.stream.lastToken = this.response?.token ?? this.stream.lastToken;
    this.response?.close();
    this.abort.abort();
  }
}
