import { FormatError } from "../format/bytes/errors.js";
import { isSnapshot, layerOf, masksOf, snapshotOf } from "../format/manifest.js";
import { inflatePacket, isGzip, limitBytes } from "../format/packet.js";

/** Seconds of media that are inflated ahead. */
const AHEAD_S = 1;
const LEAST_AHEAD_FRAMES = 16;
/** Number of packets inflated at a time. */
const BATCH = 16;

/** @typedef {import("../format/manifest.js").Part} Part */
/** @typedef {{ birth: number, part: Part, packet: Uint8Array }} Arrived */

/**
 * Inflates the packets of a cache and passes them to a StreamPlay: those of the segment where it begins,
 * those that show soon, and late ones for frames that have already shown.
 */
export class ChunkFeed {
  /**
   * @param {import("../source/segmentcache.js").SegmentCache} cache
   * @param {import("./streamplay.js").StreamPlay} play
   * @param {import("../format/manifest.js").Manifest} manifest
   * @param {number} firstFrame
   * @param {number} numLayers number of layers that are passed on
   * @param {number} rate playback rate
   */
  constructor(cache, play, manifest, firstFrame, numLayers, rate) {
    this.cache = cache;
    this.play = play;
    this.manifest = manifest;
    this.numLayers = numLayers;
    /** First frame of the segment that is joined by its snapshots. */
    this.startFrame = cache.segmentOf(firstFrame) * manifest.segmentFrames;
    /** End of the range of frames whose packets are passed on. */
    this.endFrame = this.startFrame;
    /** @type {Arrived[]} in the order in which they are inflated */
    this.queue = [];
    this.isRunning = false;
    this.isClosed = false;
    /** @type {unknown} */
    this.failure = null;
    /** Called after packets were passed on, or after a failure. */
    this.onData = () => {};
    /** @type {import("../source/segmentcache.js").PacketListener} */
    this.listener = (birth, part, packet) => {
      if (birth < this.startFrame || birth >= this.endFrame) return;
      this.#enqueue(birth, part, packet);
      this.#run();
    };
    cache.listeners.add(this.listener);
    this.advance(firstFrame + 1, rate);
  }

  /**
   * Passes on the packets that show soon.
   * @param {number} nextFrame
   * @param {number} rate playback rate
   */
  advance(nextFrame, rate) {
    const frames = AHEAD_S * this.manifest.fps * Math.max(1, rate);
    const endFrame = Math.ceil(nextFrame + Math.max(LEAST_AHEAD_FRAMES, frames));
    for (; this.endFrame < endFrame; this.endFrame++) this.#lookUp(this.endFrame, 0);
    this.#run();
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
    this.#run();
  }

  /**
   * Enqueues the cached packets of a frame.
   * @param {number} birth
   * @param {number} firstLayer
   */
  #lookUp(birth, firstLayer) {
    const { manifest } = this;
    if (firstLayer === 0) this.#enqueue(birth, masksOf(manifest));
    for (let layer = firstLayer; layer < this.numLayers; layer++) {
      if (birth % manifest.segmentFrames === 0) this.#enqueue(birth, snapshotOf(manifest, layer));
      this.#enqueue(birth, layer);
    }
  }

  /**
   * @param {number} birth
   * @param {Part} part
   */
  #enqueue(birth, part, packet = this.cache.packet(birth, part)) {
    const { manifest, startFrame } = this;
    // The first frame of the segment that is joined needs its snapshots only.
    if (packet === null || (birth === startFrame && !isSnapshot(manifest, part))) return;
    if (layerOf(manifest, part) < this.numLayers) this.queue.push({ birth, part, packet });
  }

  async #run() {
    if (this.isRunning) return;
    this.isRunning = true;
    try {
      while (this.queue.length > 0 && !this.isClosed) {
        const batch = this.queue.splice(0, BATCH);
        const chunks = await Promise.all(batch.map((arrived) => this.#inflated(arrived)));
        if (this.isClosed) return;
        for (const [n, { birth, part }] of batch.entries()) {
          const chunk = chunks[n];
          if (chunk !== null) this.#pass(birth, part, chunk);
        }
        this.onData();
      }
    } catch (error) {
      this.failure = error;
      this.onData();
    } finally {
      this.isRunning = false;
    }
  }

  /** The chunk of a packet; null if it is damaged, and is of a layer above 0. @param {Arrived} arrived */
  async #inflated({ birth, part, packet }) {
    try {
      return isGzip(packet) ? await inflatePacket(packet, limitBytes(this.manifest, part)) : packet;
    } catch (error) {
      const layer = layerOf(this.manifest, part);
      if (layer === 0 || !(error instanceof FormatError)) throw error;
      this.play.lose(birth, layer, error);
      return null;
    }
  }

  /**
   * @param {number} birth
   * @param {Part} part
   * @param {Uint8Array} chunk
   */
  #pass(birth, part, chunk) {
    const { manifest, play } = this;
    if (part === masksOf(manifest)) play.addMask(birth, chunk);
    else if (isSnapshot(manifest, part)) play.addSnapshot(birth, layerOf(manifest, part), chunk);
    else play.addChange(birth, part, chunk);
  }

  close() {
    this.isClosed = true;
    this.onData = () => {};
    this.queue = [];
    this.cache.listeners.delete(this.listener);
  }
}
