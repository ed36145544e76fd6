import { FormatError } from "../format/bytes/errors.js";
import { SlotDecoder } from "../format/slots/slotdecoder.js";
import { packSlots } from "./packing.js";

/**
 * The chunks of a stream that are here, and what they make of the slots, frame by frame.
 * Chunks may come in any order, and are used when their frame has shown, too.
 */
export class StreamPlay {
  /** @param {import("../format/manifest.js").Manifest} manifest */
  constructor(manifest) {
    this.layout = manifest.layout;
    this.decoder = this.#newDecoder();
    /** @type {Map<number, Uint8Array>} by birth */
    this.masks = new Map();
    /** @type {Map<number, (Uint8Array | null)[]>} by birth, of each layer */
    this.changes = new Map();
    /** @type {Map<number, (Uint8Array | null)[]>} by first frame of a segment, of each layer */
    this.snapshots = new Map();
    /** Chunks that were refused: their layers go without. */
    this.refused = 0;
    /** Whether something came of use to what shows already, since all of it was handed out. */
    this.isLate = false;
  }

  #newDecoder() {
    return new (this.layout.Decoder ?? SlotDecoder)(this.layout);
  }

  /** The frame that was brought last; null before the first. */
  get frame() {
    return this.decoder.frame;
  }

  /** Layers that show whole. */
  get layers() {
    const { numLayers } = this.layout;
    for (let layer = 0; layer < numLayers; layer++) if (this.#lacksAnything(layer)) return layer;
    return numLayers - this.decoder.numMissing;
  }

  /** @param {number} layer */
  #lacksAnything(layer) {
    return this.decoder.lanes.some((lane) => lane[layer].hasUnknown);
  }

  /**
   * @param {number} birth
   * @param {Uint8Array} chunk of no bytes where all is kept
   */
  addMask(birth, chunk) {
    if (this.frame === null || birth > this.frame) this.masks.set(birth, chunk);
  }

  /**
   * @param {number} birth
   * @param {number} layer
   * @param {Uint8Array} chunk of no bytes where nothing changes
   */
  addChange(birth, layer, chunk) {
    if (this.frame === null || birth > this.frame) this.#row(this.changes, birth)[layer] = chunk;
    else this.#tryLate(() => this.decoder.late(birth, layer, chunk));
  }

  /**
   * @param {number} frame
   * @param {number} layer
   * @param {Uint8Array} chunk
   */
  addSnapshot(frame, layer, chunk) {
    if (this.frame === null || frame > this.frame) this.#row(this.snapshots, frame)[layer] = chunk;
    else if (frame === this.layout.segmentStart(this.frame)) {
      this.#tryLate(() => this.decoder.load(chunk, layer, frame));
    }
  }

  /** Whether what layer 0 of a slice changes is here. @param {number} birth */
  hasSlice(birth) {
    return this.masks.has(birth) && Boolean(this.changes.get(birth)?.[0]);
  }

  /**
   * Whether `advance` can go on with `frame`.
   * @param {number} frame
   * @param {number} numFrames of the stream
   */
  canAdvance(frame, numFrames) {
    return this.hasSlice(frame) || this.#canRejoin(frame, numFrames);
  }

  /**
   * Whether a segment whose first slice is not here can be joined by its snapshot. While the first
   * slice may still come with the others, it is better: it keeps what shows.
   * @param {number} frame
   * @param {number} numFrames
   */
  #canRejoin(frame, numFrames) {
    if (!this.snapshots.get(frame)?.[0]) return false;
    return frame + 1 >= numFrames || this.hasSlice(frame + 1);
  }

  /** Whether `join` can begin with `frame`: all of layer 0 that it needs is here. @param {number} frame */
  has(frame) {
    const first = this.layout.segmentStart(frame);
    if (!this.snapshots.get(first)?.[0]) return false;
    for (let birth = first + 1; birth <= frame; birth++) if (!this.hasSlice(birth)) return false;
    return true;
  }

  /**
   * Begins with `frame`: all that it shows. Throws a FormatError if layer 0 is refused.
   * @param {number} frame
   */
  join(frame) {
    const first = this.layout.segmentStart(frame);
    this.decoder = this.#newDecoder();
    this.masks.delete(first);
    this.changes.delete(first);
    this.#load(first);
    for (let birth = first + 1; birth <= frame; birth++)
      this.#apply(birth, birth < frame ? undefined : this);
    return this.again(frame);
  }

  /** All that shows, with what came late. @param {number} frame that shows */
  again(frame) {
    this.isLate = false;
    return this.decoder.handOut().map((slice) => packSlots(this.decoder, slice, frame));
  }

  /**
   * Goes on by one frame: what is new in it, or all of it if it begins anew. Throws a FormatError if
   * its mask is refused.
   * @param {number} frame
   */
  advance(frame) {
    if (!this.hasSlice(frame) && this.snapshots.get(frame)?.[0])
      return { isJoin: true, updates: this.join(frame) };
    const slice = this.#apply(frame, this);
    if (frame === this.layout.segmentStart(frame)) this.#load(frame);
    return { isJoin: false, updates: [packSlots(this.decoder, slice, frame)] };
  }

  /**
   * @param {number} birth
   * @param {StreamPlay} [ahead] if it shows
   */
  #apply(birth, ahead) {
    const mask = this.masks.get(birth) ?? null;
    const changes = this.#row(this.changes, birth);
    this.masks.delete(birth);
    this.changes.delete(birth);
    try {
      return this.decoder.apply(birth, mask, changes, ahead);
    } catch (error) {
      if (!(error instanceof FormatError)) throw error;
    }
    // A change that is refused counts as missing (FORMAT.md, section 7).
    const taken = changes.map((change, layer) => {
      const takes = () =>
        this.decoder.takes(birth, mask, layer, /** @type {Uint8Array} */ (change));
      return change !== null && this.#try(takes) ? change : null;
    });
    return this.decoder.apply(birth, mask, taken, ahead);
  }

  /** Loads the snapshots of `frame` of layers that lack something. @param {number} frame */
  #load(frame) {
    const chunks = this.snapshots.get(frame) ?? [];
    for (const [layer, chunk] of chunks.entries()) {
      if (chunk === null || (this.frame !== null && !this.#lacksAnything(layer))) continue;
      if (layer === 0 && this.frame === null) this.decoder.load(chunk, layer, frame);
      else this.#try(() => this.decoder.load(chunk, layer, frame));
    }
    for (const known of this.snapshots.keys()) if (known <= frame) this.snapshots.delete(known);
  }

  /** @param {() => boolean} action that says whether it was of use */
  #tryLate(action) {
    if (this.#try(action)) this.isLate = true;
  }

  /** @param {() => boolean} action */
  #try(action) {
    try {
      return action();
    } catch (error) {
      if (!(error instanceof FormatError)) throw error;
      this.refused += 1;
      return false;
    }
  }

  /**
   * @param {Map<number, (Uint8Array | null)[]>} table
   * @param {number} key
   */
  #row(table, key) {
    let row = table.get(key);
    if (row === undefined) {
      row = new Array(this.layout.numLayers).fill(null);
      table.set(key, row);
    }
    return row;
  }
}
