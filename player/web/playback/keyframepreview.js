import { keyframeOf, limitBytes } from "../format/manifest.js";
import { zstdContent } from "../format/zstd.js";
import { FrameAssembler } from "./frameassembler.js";

/**
 * Shows pictures while the thumb of the track moves: layer 0 of the keyframe nearest to the thumb, from
 * the cache or fetched. It makes one request at a time, always for the newest target.
 */
export class KeyframePreview {
  /** Whether the user holds the thumb. */
  isActive = false;
  /** @type {number | null} segment whose picture is wanted */
  target = null;
  /** @type {number | null} segment whose picture shows */
  shown = null;
  isRunning = false;
  abort = new AbortController();

  /**
   * @param {import("../source/source.js").SourceStream} stream
   * @param {(shown: import("./playback.js").Shown) => void} show
   * @param {() => void} onFetch called before something is requested
   */
  constructor(stream, show, onFetch) {
    this.stream = stream;
    this.show = show;
    /** @type {() => void} */ this.onFetch = onFetch;
  }

  /** Shows a picture near `frame` as soon as possible. @param {number} frame */
  scrub(frame) {
    const { manifest, numFrames } = this.stream;
    if (!this.isActive) this.abort = new AbortController();
    this.isActive = true;
    const last = Math.ceil(numFrames / manifest.segmentFrames) - 1;
    this.target = Math.max(0, Math.min(last, Math.round(frame / manifest.segmentFrames)));
    this.#run();
  }

  async #run() {
    if (this.isRunning) return;
    this.isRunning = true;
    const { signal } = this.abort;
    while (!signal.aborted && this.target !== null && this.target !== this.shown) {
      const segment = this.target;
      try {
        if (this.stream.cache.keyframe(segment, 0) === null) {
          this.onFetch();
          await this.stream.fetchKeyframe(segment, 0, signal);
        }
        if (!signal.aborted) this.#showSegment(segment);
      } catch (error) {
        if (signal.aborted) break;
        // The next target may have a picture.
        console.warn(`There is no picture of segment ${segment}: ${error}`);
      }
      if (this.target === segment) this.target = null;
    }
    this.isRunning = false;
    // Scrubbing was ended and begun again meanwhile.
    if (this.isActive && signal.aborted) this.#run();
  }

  /** @param {number} segment */
  #showSegment(segment) {
    const { manifest, cache } = this.stream;
    const packet = cache.keyframe(segment, 0);
    if (packet === null) return;
    const chunk = zstdContent(packet, limitBytes(manifest, keyframeOf(manifest, 0)));
    const frame = segment * manifest.segmentFrames;
    const chunks = new FrameAssembler(manifest);
    chunks.addKeyframe(frame, 0, chunk);
    this.show({ frame, isJoin: true, updates: chunks.join(frame) });
    this.shown = segment;
  }

  /** Ends scrubbing when the thumb is released; aborts pending requests. */
  end() {
    this.isActive = false;
    this.target = null;
    this.shown = null;
    this.abort.abort();
  }
}
