import { ChunkFeed } from "./chunkfeed.js";
import { Playback } from "./playback.js";
import { StreamPlay } from "./streamplay.js";

/**
 * One run through a stream, from a frame to the end or to a seek: the source that fetches missing data,
 * the chunks, and the playback state.
 */
export class Round {
  /**
   * @param {import("../source/source.js").SourceStream} stream
   * @param {import("../source/source.js").SourcePlay} source
   * @param {number} firstFrame
   * @param {number} numLayers maximum number of layers to show
   * @param {number} rate
   */
  constructor(stream, source, firstFrame, numLayers, rate) {
    const { cache, manifest, numFrames } = stream;
    this.stream = stream;
    this.source = source;
    this.chunks = new StreamPlay(manifest);
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
   * @param {boolean} isPlaying
   * @param {number} rate
   * @param {boolean} loops
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
