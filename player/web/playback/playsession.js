import { CODED } from "../constants.js";
import { FormatError } from "../format/bytes.js";
import { isKeyframe, keyframeOf, layerOf, limitBytes, skipMapsOf } from "../format/manifest.js";
import { zstdContent } from "../format/zstd.js";
import { FrameAssembler } from "./frameassembler.js";
import { Playback } from "./playback.js";

/** Seconds of media that are decompressed ahead. */
const AHEAD_S = 1;
const LEAST_AHEAD_FRAMES = 16;

/** @typedef {import("../format/manifest.js").Part} Part */

/** @type {typeof import("../format/planes.js") | null} */
let planes = null;

/** Loads what decodes the packets of changes; the first picture of a stream does not need it. */
export async function loadPlanes() {
  planes ??= await import("../format/planes.js");
}

/**
 * Decompresses the packets of a cache and passes them to a FrameAssembler: those of the segment where it begins,
 * those that show soon, and late ones for frames that have already shown.
 */
export class ChunkFeed {
  /** @type {unknown} */
  failure = null;
  /** Called after a packet that has arrived was passed on, or after a failure. */
  onData = () => {};
  /** @type {import("../source/segmentcache.js").PacketListener} */
  listener = (birth, part, packet) => {
    if (birth < this.startFrame || birth >= this.endFrame) return;
    this.#pass(birth, part, packet);
    this.onData();
  };

  /**
   * @param {import("../source/segmentcache.js").SegmentCache} cache
   * @param {import("./frameassembler.js").FrameAssembler} play
   * @param {import("../format/manifest.js").Manifest} manifest @param {number} firstFrame
   * @param {number} numLayers number of layers that are passed on
   */
  constructor(cache, play, manifest, firstFrame, numLayers) {
    this.cache = cache;
    /** @type {FrameAssembler} */ this.play = play;
    this.manifest = manifest;
    /** @type {number} */ this.numLayers = numLayers;
    /** First frame of the segment that is joined by its keyframes. @type {number} */
    this.startFrame = cache.segmentOf(firstFrame) * manifest.segmentFrames;
    /** End of the range of frames whose packets are passed on. @type {number} */
    this.endFrame = this.startFrame;
    cache.listeners.add(this.listener);
    // The first picture need not wait for what comes after it.
    this.#lookUpTo(firstFrame + 1);
  }

  /** Passes on the packets that show soon. @param {number} nextFrame @param {number} rate playback rate */
  advance(nextFrame, rate) {
    const frames = AHEAD_S * this.manifest.fps * Math.max(1, rate);
    this.#lookUpTo(Math.ceil(nextFrame + Math.max(LEAST_AHEAD_FRAMES, frames)));
  }

  /** @param {number} endFrame */
  #lookUpTo(endFrame) {
    for (; this.endFrame < endFrame; this.endFrame++) this.#lookUp(this.endFrame, 0);
  }

  /**
   * Sets the number of layers to pass on; additional layers also for the segment that shows already.
   * @param {number} numLayers @param {number} frame the current one
   */
  setLayers(numLayers, frame) {
    const known = this.numLayers;
    this.numLayers = numLayers;
    const { segmentFrames } = this.manifest;
    const first = this.cache.segmentOf(frame) * segmentFrames;
    for (let birth = first; birth < this.endFrame; birth++) this.#lookUp(birth, known);
  }

  /** Passes on the cached packets of a frame. @param {number} birth @param {number} firstLayer */
  #lookUp(birth, firstLayer) {
    const { manifest } = this;
    if (firstLayer === 0) this.#pass(birth, skipMapsOf(manifest));
    for (let layer = firstLayer; layer < this.numLayers; layer++) {
      if (birth % manifest.segmentFrames === 0) this.#pass(birth, keyframeOf(manifest, layer));
      this.#pass(birth, layer);
    }
  }

  /** @param {number} birth @param {Part} part */
  #pass(birth, part, packet = this.cache.packet(birth, part)) {
    const { manifest, play, startFrame } = this;
    const layer = layerOf(manifest, part);
    // The first frame of the segment that is joined needs its keyframes only.
    if (packet === null || (birth === startFrame && !isKeyframe(manifest, part))) return;
    if (layer >= this.numLayers) return;
    if (packet[0] === CODED && planes === null) {
      loadPlanes()
        .then(() => this.#pass(birth, part, packet))
        .catch((error) => (this.failure ??= error))
        .finally(() => this.onData());
      return;
    }
    try {
      const decode = planes?.packetContent ?? zstdContent;
      const chunk = decode(packet, limitBytes(manifest, part));
      if (part === skipMapsOf(manifest)) play.addSkipMap(birth, chunk);
      else if (isKeyframe(manifest, part)) play.addKeyframe(birth, layer, chunk);
      else play.addChange(birth, layer, chunk);
    } catch (error) {
      // A packet that is damaged is missing in its layer; skip maps count as layer 0.
      if (layer > 0 && error instanceof FormatError) play.lose(birth, layer, error);
      else this.failure ??= error;
    }
  }

  close() {
    this.onData = () => {};
    this.cache.listeners.delete(this.listener);
  }
}

/**
 * One run through a stream, from a frame to the end or to a seek: the source that fetches missing data,
 * the chunks, and the playback state.
 */
export class PlaySession {
  /**
   * @param {import("../source/source.js").SourceStream} stream
   * @param {import("../source/source.js").SourcePlay} source @param {number} firstFrame
   * @param {number} numLayers maximum number of layers to show @param {number} rate
   */
  constructor(stream, source, firstFrame, numLayers, rate) {
    const { cache, manifest, numFrames } = stream;
    this.stream = stream;
    this.source = source;
    this.chunks = new FrameAssembler(manifest);
    this.chunks.onLost = (birth, layer, why) =>
      this.source.lose?.(cache.segmentOf(birth), layer, why);
    this.feed = new ChunkFeed(cache, this.chunks, manifest, firstFrame, numLayers);
    this.playback = new Playback(this.chunks, manifest.fps, numFrames, firstFrame);
    this.playback.live = manifest.live;
    this.playback.setRate(rate);
  }

  /** The error that ended the round; null if there is none. */
  get failure() {
    return this.source.failure ?? this.feed.failure;
  }

  /** Whether frames may still show, also after a failure. */
  get canGoOn() {
    return this.playback.canGoOn || this.source.isFetching;
  }

  /**
   * Tells cache, feed and source where playback is.
   * @param {boolean} isPlaying @param {number} rate @param {boolean} loops
   */
  tellPosition(isPlaying, rate, loops) {
    const { feed, playback, source, stream } = this;
    const { cache, manifest, numFrames } = stream;
    const { nextFrame } = playback;
    cache.setPlayhead(nextFrame, loops && !manifest.live ? numFrames : null);
    feed.advance(nextFrame, rate);
    const moves = isPlaying && !playback.hasEnded;
    source.reportPosition(moves ? nextFrame : playback.frame, !moves, rate);
  }

  /** The first frame that cannot show before more data is received. */
  get endFrame() {
    const { playback, stream } = this;
    const end = stream.cache.endOf(playback.nextFrame, stream.numFrames);
    return Math.max(playback.endFrame, end);
  }

  /** Uses another source play from now on. @param {import("../source/source.js").SourcePlay} source */
  replaceSource(source) {
    this.source.close();
    this.source = source;
  }

  /** Ends the round, but returns its source for further use. */
  detach() {
    this.feed.close();
    return this.source;
  }

  close() {
    this.feed.close();
    this.source.close();
  }
}
