import { corrupt } from "../format/bytes/errors.js";
import { isGzip, limitBytes } from "../format/packet.js";
import { GoneError, openPlay, ServerRetry } from "./playresponse.js";
import { AHEAD_S } from "./segmentcache.js";

/** Seconds between two status reports to the server. */
const REPORT_S = 1;

/** @typedef {import("./served.js").ServedStream} ServedStream */
/** @typedef {import("./playresponse.js").PlayResponse} PlayResponse */

/**
 * Frames that the cache lacks.
 * @typedef {object} Gap
 * @property {number} fromFrame to ask the server for
 * @property {number | undefined} untilFrame the first frame behind the gap that is here
 * @property {number[]} snapshots layers, if their snapshots are all that is missing of its segment
 */

/**
 * One play of a swings server: asks for the frames that the cache lacks, as far ahead as the cache
 * holds them, and again if the connection breaks.
 */
export class ServedPlay {
  /**
   * @param {ServedStream} stream
   * @param {import("./source.js").PlayRequest} request
   */
  constructor(stream, { firstFrame, mostLayers, nowS }) {
    this.stream = stream;
    this.mostLayers = mostLayers;
    this.nowS = nowS;
    this.firstFrame = firstFrame;
    /** Behind the last frame that was found in the cache, or was sent. */
    this.endBirth = firstFrame;
    this.nextFrame = firstFrame;
    this.paused = false;
    this.reportedS = -Infinity;
    /** @type {number | null} what the server takes the link to carry */
    this.rateBps = null;
    /** @type {unknown} */
    this.failure = null;
    this.isClosed = false;
    /** Whether nothing more will be asked for. */
    this.isDone = false;
    /** @type {() => void} called when something has come or failed */
    this.onData = () => {};
    this.abort = new AbortController();
    /** @type {PlayResponse | null} */
    this.response = null;
    this.moveOn = () => {};
    this.patience = new ServerRetry(stream.fetcher, stream.base);
    // After the first report of the position.
    Promise.resolve()
      .then(() => this.#run())
      .catch((error) => this.#fail(error));
  }

  /** @param {unknown} error */
  #fail(error) {
    if (this.isClosed) return;
    this.failure = error;
    this.onData();
  }

  step() {
    return REPORT_S;
  }

  /**
   * Forwards the position to the server, once a second at most.
   * @param {number} frame
   * @param {boolean} paused
   * @param {number} rate
   */
  reportPosition(frame, paused, rate) {
    // Before its first frame a play stands still there.
    const isEarly = frame < 0;
    const isPaused = paused || isEarly;
    this.nextFrame = isEarly ? this.firstFrame : frame;
    this.moveOn();
    const nowS = this.nowS();
    const periodS = REPORT_S / Math.max(1, rate);
    if (isPaused === this.paused && nowS - this.reportedS < periodS) return;
    this.paused = isPaused;
    this.reportedS = nowS;
    this.#postReport();
  }

  async #postReport() {
    const token = this.response?.token;
    if (!token) return;
    const body = JSON.stringify({ frame: this.nextFrame, paused: this.paused });
    try {
      const answer = await fetch(`${this.stream.base}play/${token}`, { method: "POST", body });
      const rateBps = Number(answer.headers.get("Swings-Rate"));
      if (rateBps > 0) this.rateBps = this.stream.rateBps = rateBps;
    } catch {
      // The response shows soon enough that the server is gone.
    }
  }

  /**
   * Goes on from another frame, see SourcePlay.
   * @param {number} frame
   * @param {boolean} isStep
   */
  moveTo(frame, isStep) {
    const { stream, mostLayers, firstFrame, endBirth } = this;
    const { cache } = stream;
    if (this.isClosed || frame < firstFrame || frame >= endBirth) return false;
    const segment = cache.segmentOf(frame);
    const isHere = cache.hasAllChanges(segment, stream.framesIn(segment), mostLayers);
    const missing = isStep ? [] : cache.missingSnapshots(segment, mostLayers);
    if (!isHere || (missing.length > 0 && !stream.hasObjects)) return false;
    for (let next = segment + 1; next < cache.segmentOf(endBirth); next++) {
      if (!cache.isComplete(next, stream.framesIn(next), mostLayers)) return false;
    }
    this.#fetchSnapshots(segment, missing).catch((error) => this.#fail(error));
    return true;
  }

  async #run() {
    const { stream, patience } = this;
    while (!this.isClosed) {
      const gap = this.#findGap();
      this.isDone = gap === null;
      if (gap === null || !this.#isNear(gap)) {
        this.onData();
        await this.#position();
        continue;
      }
      if (gap.snapshots.length > 0 && stream.hasObjects) {
        await this.#fetchSnapshots(this.#segmentOf(gap.fromFrame), gap.snapshots);
        if (stream.hasObjects) continue;
      }
      const { endBirth } = this;
      this.response = await this.#open(gap);
      if (this.isClosed) this.response.close();
      this.reportedS = -Infinity; // so that the next report goes to this response
      try {
        if (await this.#takeAll(this.response, gap)) {
          patience.reset();
          // What a server left out of these frames it is not asked for again in this play.
          this.endBirth = Math.max(endBirth, gap.untilFrame ?? stream.numFrames);
          continue;
        }
      } catch (error) {
        if (!(error instanceof GoneError)) throw error;
      } finally {
        stream.lastToken = this.response.token;
        this.response = null;
      }
      if (this.isClosed) return;
      // A server that answers and then breaks off may do so for ever.
      if (this.endBirth > endBirth) patience.reset();
      else await patience.wait();
    }
  }

  /** The first frames from `endBirth` on that are not here; null if there are none. @returns {Gap | null} */
  #findGap() {
    const { stream, firstFrame } = this;
    const { cache, numFrames, manifest } = stream;
    for (;;) {
      if (this.endBirth >= numFrames) {
        if (!manifest.live) return null;
        return { fromFrame: numFrames - 1, untilFrame: undefined, snapshots: [] };
      }
      const segment = this.#segmentOf(this.endBirth);
      const start = segment * manifest.segmentFrames;
      const size = stream.framesIn(segment);
      const isJoin = this.#isJoin(segment);
      const snapshots = this.#missingSnapshots(segment);
      const isHere = this.#hasChanges(segment);
      if (isHere && snapshots.length === 0) {
        this.endBirth = start + size;
        continue;
      }
      // The first slice of a segment is not sent to a play that begins with it, nor needed there.
      const first = isJoin ? firstFrame : start;
      const hasBase = !isJoin || cache.snapshot(segment, 0) !== null;
      const end = hasBase ? cache.endOf(isJoin ? start : first, start + size) : first;
      const fromFrame = end < start + size ? Math.max(first, end - 1) : first;
      return { fromFrame, untilFrame: this.#endOfGap(segment), snapshots: isHere ? snapshots : [] };
    }
  }

  /**
   * The next frame behind a segment that need not be sent: it is here, or too far ahead for a still
   * picture.
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

  /** Whether it is time to ask for a gap: a paused play only needs its own segment. @param {Gap} gap */
  #isNear({ fromFrame }) {
    const { stream, nextFrame } = this;
    if (this.#segmentOf(fromFrame) <= this.#segmentOf(nextFrame)) return true;
    // Only its plays show that a live stream grows.
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

  /**
   * Fetches these layers' snapshots, layer 0 first.
   * @param {number} segment
   * @param {number[]} layers
   */
  async #fetchSnapshots(segment, layers) {
    const { stream, abort } = this;
    for (const layer of layers) {
      try {
        if (!(await stream.fetchSnapshot(segment, layer, abort.signal))) return;
      } catch (error) {
        if (this.isClosed) return;
        if (!(error instanceof GoneError)) throw error;
        await this.patience.wait();
      }
      this.onData();
    }
  }

  /** The response that brings what is not here. @param {Gap} gap */
  async #open({ fromFrame, untilFrame }) {
    const { stream, mostLayers } = this;
    const { first, base, lastToken, rateBps } = stream;
    stream.first = null;
    const layers = mostLayers < stream.manifest.numLayers ? mostLayers : null;
    if (first !== null && fromFrame === 0 && layers === null && untilFrame === undefined) {
      return first;
    }
    first?.close();
    const paused = this.paused && fromFrame === this.nextFrame;
    // Else the server would send a whole lead beyond the one that is here.
    const nextFrame = fromFrame > this.nextFrame ? this.nextFrame : null;
    const query = { fromFrame, untilFrame, layers, lastToken, rateBps, paused, nextFrame };
    const { signal } = this.abort;
    const { response, start } = await this.patience.begin(() => openPlay(base, query, signal));
    stream.grow(start.numFrames, stream.manifest.live);
    return response;
  }

  /**
   * Puts all that a response brings into the cache; gives whether it came to its end.
   * @param {PlayResponse} response
   * @param {Gap} gap
   */
  async #takeAll(response, gap) {
    const { stream } = this;
    for (;;) {
      const record = await response.next((numBytes) => (stream.fetcher.receivedBytes += numBytes));
      if (this.isClosed || record === null) return false;
      if (record.kind === "end") {
        if (gap.untilFrame === undefined) stream.grow(record.numFrames, false);
        this.onData();
        return true;
      }
      if (record.kind === "error") {
        this.patience.why = `The server reports: ${record.message}`;
        return false;
      }
      if (record.kind !== "start") this.#take(record);
      this.onData();
      await this.#room();
    }
  }

  /** @param {import("../constants.js").SliceRecord | import("../constants.js").SnapshotRecord} record */
  #take(record) {
    const { manifest, cache } = this.stream;
    const isSnapshot = record.kind === "snapshot";
    const birth = isSnapshot ? record.frame : record.birth;
    // What comes far ahead of layer 0 is of no use, and would stay.
    if (birth < 0 || birth > this.endBirth + manifest.segmentFrames) {
      throw corrupt(`play: the slice born at ${birth} arrived, but birth ${this.endBirth} is next`);
    }
    if (!isSnapshot && record.mask !== null) {
      cache.addMask(birth, checked(record.mask, limitBytes(manifest, "masks")));
    }
    for (const [n, packet] of record.packets.entries()) {
      const layer = record.firstLayer + n;
      if (layer >= manifest.numLayers)
        throw corrupt(
          `play: a packet of layer ${layer}, but the stream has ${manifest.numLayers} layers`,
        );
      const part = isSnapshot ? `snapshot-${layer}` : `${layer}`;
      const held = checked(packet, limitBytes(manifest, part));
      if (isSnapshot) cache.addSnapshot(birth, layer, held);
      else cache.addChange(birth, layer, held);
    }
    if (isSnapshot || record.firstLayer > 0) return;
    this.endBirth = Math.max(this.endBirth, birth + 1);
    this.stream.grow(this.endBirth, manifest.live);
  }

  /** Waits while too much is here that has not shown. */
  async #room() {
    const { cache, manifest } = this.stream;
    const isFar = () =>
      this.endBirth > this.nextFrame + this.#mostAhead + manifest.segmentFrames ||
      (!this.#isRefining && !cache.hasRoomFor(this.#segmentOf(this.endBirth)));
    while (!this.isClosed && isFar()) await this.#position();
  }

  /** Whether layers of a still picture are missing: they may come behind what shows later. */
  get #isRefining() {
    if (!this.paused) return false;
    const segment = this.#segmentOf(this.nextFrame);
    return !this.#hasChanges(segment) || this.#missingSnapshots(segment).length > 0;
  }

  /** Whether all changes of a segment that this play needs are here. @param {number} segment */
  #hasChanges(segment) {
    const { stream, mostLayers } = this;
    const size = stream.framesIn(segment);
    return this.#isJoin(segment)
      ? stream.cache.hasAllChanges(segment, size, mostLayers)
      : stream.cache.isComplete(segment, size, mostLayers);
  }

  /** Layers whose snapshots this play needs and lacks. @param {number} segment */
  #missingSnapshots(segment) {
    const { cache } = this.stream;
    return this.#isJoin(segment) ? cache.missingSnapshots(segment, this.mostLayers) : [];
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
    this.onData = () => {};
    this.patience.isOver = true;
    this.moveOn();
    this.stream.lastToken = this.response?.token ?? this.stream.lastToken;
    this.response?.close();
    this.abort.abort();
  }
}

/**
 * A packet as it comes: of coder gzip, or the chunk in one of coder zstd, of which `most` bytes are
 * allowed.
 * @param {Uint8Array} packet
 * @param {number} most
 */
function checked(packet, most) {
  if (!isGzip(packet) && packet.length > most)
    throw corrupt(`play: a chunk has ${packet.length} bytes, but at most ${most} are allowed`);
  return packet;
}
