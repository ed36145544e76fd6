import { FormatError } from "../format/bytes/errors.js";
import { layerOf, limitBytes, packetContent } from "../format/packet.js";

/** Seconds of media that are decompressed ahead. */
const AHEAD_S = 1;
const LEAST_AHEAD_FRAMES = 16;

/**
 * Decompresses the packets of a cache and passes them to a StreamPlay: those of the segment where it begins,
 * those that show soon, and late ones for frames that have already shown.
 */
export class ChunkFeed {
  /**
   * @param {import("../source/segmentcache.js").SegmentCache} cache
   * @param {import("./streamplay.js").StreamPlay} play
   * @param {import("../format/manifest.js").Manifest} manifest
   * @param {number} firstFrame
   * @param {number} numLayers number of layers that are passed on
   */
  constructor(cache, play, manifest, firstFrame, numLayers) {
    this.cache = cache;
    this.play = play;
    this.manifest = manifest;
    this.numLayers = numLayers;
    /** First frame of the segment that is joined by its snapshots. */
    this.startFrame = cache.segmentOf(firstFrame) * manifest.segmentFrames;
    /** End of the range of frames whose packets are passed on. */
    this.endFrame = this.startFrame;
    /** @type {unknown} */
    this.failure = null;
    /** Called after a packet that has arrived was passed on, or after a failure. */
    this.onData = () => {};
    /** @type {import("../source/segmentcache.js").PacketListener} */
    this.listener = (birth, part, packet) => {
      if (birth < this.startFrame || birth >= this.endFrame) return;
      this.#pass(birth, part, packet);
      this.onData();
    };
    cache.listeners.add(this.listener);
    // The first picture need not wait for what comes after it.
    this.#lookUpTo(firstFrame + 1);
  }

  /**
   * Passes on the packets that show soon.
   * @param {number} nextFrame
   * @param {number} rate playback rate
   */
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
   * @param {number} numLayers
   * @param {number} frame the current one
   */
  setLayers(numLayers, frame) {
    const known = this.numLayers;
    this.numLayers = numLayers;
    const { segmentFrames } = this.manifest;
    const first = this.cache.segmentOf(frame) * segmentFrames;
    for (let birth = first; birth < this.endFrame; birth++) this.#lookUp(birth, known);
  }

  /**
   * Passes on the cached packets of a frame.
   * @param {number} birth
   * @param {number} firstLayer
   */
  #lookUp(birth, firstLayer) {
    const { cache, manifest } = this;
    const segment = cache.segmentOf(birth);
    const isFirst = birth % manifest.segmentFrames === 0;
    const mask = firstLayer === 0 ? cache.mask(birth) : null;
    if (mask !== null) this.#pass(birth, "masks", mask);
    for (let layer = firstLayer; layer < this.numLayers; layer++) {
      const snapshot = isFirst ? cache.snapshot(segment, layer) : null;
      if (snapshot !== null) this.#pass(birth, `snapshot-${layer}`, snapshot);
      const change = cache.change(birth, layer);
      if (change !== null) this.#pass(birth, `${layer}`, change);
    }
  }

  /**
   * @param {number} birth
   * @param {string} part
   * @param {Uint8Array} packet
   */
  #pass(birth, part, packet) {
    const layer = layerOf(part);
    const isSnapshot = part.startsWith("snapshot-");
    // The first frame of the segment that is joined needs its snapshots only.
    if ((birth === this.startFrame && !isSnapshot) || layer >= this.numLayers) return;
    try {
      const chunk = packetContent(packet, limitBytes(this.manifest, part));
      if (part === "masks") this.play.addMask(birth, chunk);
      else if (isSnapshot) this.play.addSnapshot(birth, layer, chunk);
      else this.play.addChange(birth, layer, chunk);
    } catch (error) {
      // A packet that is damaged is missing in its layer; masks count as layer 0.
      if (layer > 0 && error instanceof FormatError) this.play.lose(birth, layer, error);
      else this.failure ??= error;
    }
  }

  close() {
    this.onData = () => {};
    this.cache.listeners.delete(this.listener);
  }
}
