import { decodeChunk } from "../format/chunk.js";
import { FormatError, corrupt } from "../format/bytes/errors.js";
import { packLane } from "./packing.js";

/** The chunks of a stream of version 1 that are here, frame by frame; see SlotPlay. */
export class SlicePlay {
  /** @param {import("../format/manifest.js").Manifest} manifest */
  constructor(manifest) {
    this.manifest = manifest;
    this.sliceSize = manifest.numGs / manifest.swinSize;
    /** @type {number | null} */
    this.frame = null;
    /** @type {Map<number, (Uint8Array | null)[]>} by birth, of each layer; kept while it shows */
    this.slices = new Map();
    /** @type {Set<number>} births of which something came when they showed already */
    this.late = new Set();
    this.refused = 0;
  }

  /**
   * @param {number} birth
   * @param {number} layer
   * @param {Uint8Array} chunk
   */
  addChange(birth, layer, chunk) {
    if (this.frame !== null && birth <= this.frame - this.manifest.swinSize) return;
    let row = this.slices.get(birth);
    if (row === undefined) {
      row = new Array(this.manifest.numLayers).fill(null);
      this.slices.set(birth, row);
    }
    row[layer] = chunk;
    if (this.frame !== null && birth <= this.frame) this.late.add(birth);
  }

  /** Layers that show whole. */
  get layers() {
    const { swinSize, numLayers } = this.manifest;
    let most = this.frame === null ? 0 : numLayers;
    for (let n = 0; n < swinSize && most > 0; n++) {
      const gap = (this.slices.get((this.frame ?? 0) - n) ?? [null]).indexOf(null);
      if (gap >= 0) most = Math.min(most, gap);
    }
    return most;
  }

  /** Whether something came for slices that show already. */
  get isLate() {
    return this.late.size > 0;
  }

  /** Whether layer 0 of a slice is here. @param {number} birth */
  hasSlice(birth) {
    return Boolean(this.slices.get(birth)?.[0]);
  }

  /** Whether `join` can begin with `frame`: all of layer 0 that it needs is here. @param {number} frame */
  has(frame) {
    const first = frame - this.manifest.swinSize + 1;
    for (let birth = first; birth <= frame; birth++) if (!this.hasSlice(birth)) return false;
    return true;
  }

  /** Begins with `frame`: all that it shows. @param {number} frame */
  join(frame) {
    return this.again(frame);
  }

  /** All that shows, with what came late. @param {number} frame that shows */
  again(frame) {
    this.late.clear();
    const births = [];
    for (let birth = frame - this.manifest.swinSize + 1; birth <= frame; birth++)
      births.push(birth);
    return this.#bring(frame, births);
  }

  /** @param {number} frame */
  advance(frame) {
    const births = new Set([...this.late, frame]);
    this.late.clear();
    return this.#bring(frame, [...births]);
  }

  /**
   * @param {number} frame
   * @param {number[]} births
   */
  #bring(frame, births) {
    this.frame = frame;
    const oldest = frame - this.manifest.swinSize + 1;
    for (const birth of this.slices.keys()) if (birth < oldest) this.slices.delete(birth);
    return births.filter((birth) => birth >= oldest).map((birth) => this.#lane(frame, birth));
  }

  /**
   * All of a lane as its slice fills it, as far as layers are here without a gap.
   * @param {number} frame
   * @param {number} birth
   */
  #lane(frame, birth) {
    const { swinSize, shDegree, profile } = this.manifest;
    /** @type {import("./packing.js").SlicePart[]} */
    const found = [];
    let count = 0;
    for (const [layer, bytes] of (this.slices.get(birth) ?? []).entries()) {
      if (bytes === null) break;
      try {
        const chunk = decodeChunk(bytes);
        if (
          chunk.birth !== birth ||
          chunk.layer !== layer ||
          chunk.profile !== profile ||
          chunk.shDegree !== shDegree ||
          count + chunk.count > this.sliceSize
        ) {
          throw corrupt(`chunk: it does not belong to birth ${birth}, layer ${layer}`);
        }
        found.push(chunk);
        count += chunk.count;
      } catch (error) {
        if (!(error instanceof FormatError) || layer === 0) throw error;
        this.refused += 1;
        break;
      }
    }
    const lane = ((birth % swinSize) + swinSize) % swinSize;
    return packLane(shDegree, frame, lane * this.sliceSize, this.sliceSize, birth, found);
  }
}
