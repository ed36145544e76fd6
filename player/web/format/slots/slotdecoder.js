/** Masks, changes and snapshots to what a reader holds (FORMAT.md, section 7). */

import { LOG_SHARE, MIN_LOG_BYTES, NEW, PREDICTED, UNKNOWN } from "../../constants.js";
import { decodeChange } from "./change.js";
import { FormatError, corrupt } from "../bytes/errors.js";
import { MaskHistory, decodeMask } from "./mask.js";
import { movesOf } from "./moves.js";
import { changedRows, Slots } from "./slots.js";
import { decodeSnapshot } from "./snapshot.js";

/**
 * What a slice said of a layer, and the bytes of its change; null: they are missing.
 * @typedef {{ statuses: Uint8Array, change: Uint8Array | null }} Said
 */

/**
 * A layer of a lane since something of it was missing: the slices to apply again when it comes.
 * @typedef {object} Log
 * @property {Slots | null} before the slots before those slices; null if all were unknown
 * @property {Map<number, Said>} since by birth, every slice of the lane since then
 */

/**
 * What changed in a lane since it was handed out last.
 * @typedef {object} SlotSlice
 * @property {number} birth
 * @property {number} lane
 * @property {Uint32Array[]} rows the slots of each layer
 * @property {Uint8Array[]} [moves] how they came to what they hold, see `movesOf`; fewer where it is not
 *   known, and none of a whole window, or of a slice that does not show
 * @property {Slots[]} [slots] what shows of the layers, if it is not the lane itself
 */

/**
 * The chunks of slices that come later, by birth.
 * @typedef {object} Ahead
 * @property {Map<number, Uint8Array>} masks
 * @property {Map<number, (Uint8Array | null)[]>} changes of each layer
 */

/**
 * What a reader holds of the slots of layers 0 .. numLayers - 1, from one frame to the next.
 *
 * Load the snapshots of a segment's first frame, then apply the slices born after it one by one. To
 * seek, make another one. Whatever throws leaves everything as it was. Bytes that are handed in are
 * kept as long as a late packet may need them.
 */
export class SlotDecoder {
  /**
   * @param {import("./slotlayout.js").SlotLayout} layout
   * @param {number} [numLayers]
   */
  constructor(layout, numLayers = layout.numLayers) {
    this.layout = layout;
    this.numLayers = numLayers;
    /** Where the slots of each layer begin in a lane. */
    this.rowEdges = [0];
    for (const count of layout.slots)
      this.rowEdges.push(this.rowEdges[this.rowEdges.length - 1] + count);
    /** @type {number | null} birth of the slice that was applied last */
    this.frame = null;
    /** @type {Slots[][]} lane after lane, layer after layer */
    this.lanes = Array.from({ length: layout.swinSize }, () => this.#unknownLane());
    this.history = new MaskHistory(layout);
    /** @type {Uint8Array | null} statuses of the slice that was applied last; null: its mask is missing */
    this.statuses = null;
    /** Layers of which frames are missing, but nothing else. */
    this.numMissing = 0;
    /** @type {Map<string, Log>} by lane and layer, the oldest first */
    this.logs = new Map();
    /** @type {Map<number, Uint8Array>} statuses of this segment's slices, for late snapshots */
    this.said = new Map();
    /** @type {Map<string, Uint8Array>} by lane and layer, what late bytes altered since the last slice */
    this.pending = new Map();
  }

  #unknownLane() {
    const counts = this.layout.slots.slice(0, this.numLayers);
    return counts.map((count) => new Slots(count, this.layout.numAttributes, UNKNOWN));
  }

  /**
   * Takes in a snapshot, in place of what is here of its layer. It may come late.
   * @param {Uint8Array} bytes
   * @param {number} [layer] which it should be of
   * @param {number} [frame] which it should be of
   * @returns {boolean} whether it is of use
   */
  load(bytes, layer, frame) {
    const snapshot = decodeSnapshot(this.layout, bytes);
    const wanted =
      frame ?? (this.frame === null ? undefined : this.layout.segmentStart(this.frame));
    if (wanted !== undefined && snapshot.frame !== wanted) {
      throw corrupt(`snapshot: of frame ${snapshot.frame} where that of ${wanted} belongs`);
    }
    if (layer !== undefined && snapshot.layer !== layer) {
      throw corrupt(`snapshot: of layer ${snapshot.layer} where that of ${layer} belongs`);
    }
    if (snapshot.layer >= this.numLayers) return false;
    if (this.frame === null) this.frame = snapshot.frame;
    if (snapshot.frame > this.frame)
      throw new RangeError("the slices have not come to the snapshot");
    if (snapshot.frame !== this.layout.segmentStart(this.frame)) return false;
    const { swinSize } = this.layout;
    let used = false;
    for (const [i, slots] of snapshot.lanes.entries()) {
      const birth = snapshot.frame - swinSize + 1 + i;
      const since = [];
      for (let b = birth + swinSize; b <= this.frame; b += swinSize) since.push(b);
      const lane = this.layout.lane(birth);
      if (snapshot.frame === this.frame || this.#canUseLate(lane, snapshot.layer, since)) {
        this.#beginAnew(lane, snapshot.layer, slots, since);
        used = true;
      }
    }
    return used;
  }

  /**
   * Whether a snapshot from before `births` adds to a layer of a lane: something is unknown that did
   * not go missing since, and no mask is missing.
   * @param {number} lane
   * @param {number} layer
   * @param {number[]} births
   */
  #canUseLate(lane, layer, births) {
    if (births.some((birth) => !this.said.has(birth))) return false;
    const log = this.logs.get(key(lane, layer));
    /** @type {Slots | null} */
    let slots = this.lanes[lane][layer];
    if (log !== undefined) {
      const [first] = log.since.keys();
      if (births.includes(first)) slots = log.before;
    }
    return slots === null || slots.hasUnknown;
  }

  /**
   * Puts `slots` in place of a layer of a lane, and applies what is known of `births`.
   * @param {number} lane
   * @param {number} layer
   * @param {Slots} slots
   * @param {number[]} births
   */
  #beginAnew(lane, layer, slots, births) {
    const known = this.logs.get(key(lane, layer));
    /** @type {Map<number, Said>} */
    const since = new Map();
    for (const birth of births) {
      const statuses = this.said.get(birth);
      if (statuses === undefined) throw new Error(`the mask of ${birth} is not here`);
      const change = known?.since.get(birth)?.change ?? null;
      since.set(birth, { statuses: this.#ofLayer(statuses, layer), change });
    }
    this.logs.delete(key(lane, layer));
    this.#replay(lane, layer, { before: slots, since }, null);
    this.pending.set(key(lane, layer), new Uint8Array(slots.count).fill(1));
  }

  /**
   * Goes on by the slice born at `birth`, which follows the last one.
   * @param {number} birth
   * @param {Uint8Array | null} mask null: it is missing, and all slots of the lane are unknown
   * @param {(Uint8Array | null)[]} changes of layers 0, 1, ...; null for one that is missing, which
   *   may come late; layers behind the last are not expected
   * @param {Ahead} [ahead] none if a later slice is applied before anything shows
   * @returns {SlotSlice}
   */
  apply(birth, mask, changes, ahead) {
    if (this.frame === null || birth !== this.frame + 1) {
      throw new RangeError(`the slice born at ${birth} does not follow ${this.frame}`);
    }
    if (mask === null || !this.history.isReadable(birth)) return this.#loseLane(birth);
    const lane = this.layout.lane(birth);
    const statuses = decodeMask(this.layout, birth, mask, this.history.of(birth));
    const parts = this.lanes[lane].map((_, layer) => this.#ofLayer(statuses, layer));
    const deltas = this.lanes[lane].map((slots, layer) =>
      this.#delta(birth, layer, slots, parts[layer], changes[layer] ?? null),
    );
    /** @type {Uint8Array[] | undefined} */
    const moves = ahead && [];
    for (const [layer, delta] of deltas.entries()) {
      const slots = this.lanes[lane][layer];
      moves?.push(movesOf(slots, delta, parts[layer], this.layout.lattices[layer]));
      if (layer < changes.length) this.#remember(birth, layer, slots, parts[layer], changes[layer]);
      else this.logs.delete(key(lane, layer));
      slots.advance(delta);
      this.#dropIfComplete(lane, layer);
    }
    this.history.note(birth, statuses);
    this.#goOn(birth, statuses);
    return this.#handOut(birth, parts, moves);
  }

  /**
   * Whether `apply` would take a change; else throws a FormatError.
   * @param {number} birth
   * @param {Uint8Array | null} mask
   * @param {number} layer
   * @param {Uint8Array} change
   */
  takes(birth, mask, layer, change) {
    if (mask === null || !this.history.isReadable(birth)) return true;
    const statuses = decodeMask(this.layout, birth, mask, this.history.of(birth));
    const slots = this.lanes[this.layout.lane(birth)][layer];
    this.#delta(birth, layer, slots, this.#ofLayer(statuses, layer), change);
    return true;
  }

  /**
   * Takes in a change that was missing when its slice was applied.
   * @param {number} birth
   * @param {number} layer
   * @param {Uint8Array} bytes
   * @returns {boolean} whether it was still of use; the lane's next slice brings what it altered
   */
  late(birth, layer, bytes) {
    const lane = this.layout.lane(birth);
    const log = this.logs.get(key(lane, layer));
    const said = log?.since.get(birth);
    if (log === undefined || said === undefined || !isMissing(said)) return false;
    const since = new Map(log.since).set(birth, { statuses: said.statuses, change: bytes });
    this.#replay(lane, layer, { before: log.before, since }, birth);
    for (const [known, { statuses }] of since)
      if (known >= birth) this.alter(lane, layer, statuses);
    return true;
  }

  /**
   * Notes that late bytes altered what the slots hold that are not kept.
   * @param {number} lane
   * @param {number} layer
   * @param {Uint8Array} statuses
   */
  alter(lane, layer, statuses) {
    const altered = this.pending.get(key(lane, layer)) ?? new Uint8Array(statuses.length);
    statuses.forEach((status, i) => (altered[i] |= status));
    this.pending.set(key(lane, layer), altered);
  }

  /**
   * All slots of the lane of `birth`, for a renderer that has nothing yet.
   * @param {number} birth
   * @returns {SlotSlice}
   */
  whole(birth) {
    const lane = this.layout.lane(birth);
    const rows = this.lanes[lane].map((slots) => Uint32Array.from(slots.conditions, (_, i) => i));
    return { birth, lane, rows };
  }

  /** The window of the frame that was applied last; what `apply` gives follows on it. */
  handOut() {
    this.pending.clear();
    const { swinSize } = this.layout;
    const frame = this.frame ?? 0;
    return Array.from({ length: swinSize }, (_, i) => this.whole(frame - swinSize + 1 + i));
  }

  /**
   * @param {number} birth
   * @returns {SlotSlice}
   */
  #loseLane(birth) {
    const lane = this.layout.lane(birth);
    this.lanes[lane] = this.#unknownLane();
    for (let layer = 0; layer < this.numLayers; layer++) this.logs.delete(key(lane, layer));
    this.history.note(birth, null);
    this.#goOn(birth, null);
    for (let layer = 0; layer < this.numLayers; layer++) this.pending.delete(key(lane, layer));
    return this.whole(birth);
  }

  /**
   * @param {number} birth
   * @param {Uint8Array | null} statuses null: the mask is missing
   */
  #goOn(birth, statuses) {
    if (birth === this.layout.segmentStart(birth)) {
      this.said.clear();
      // The snapshots of the segment before can no longer come: only changes can.
      for (const [at, log] of this.logs) if (!isWaiting(log)) this.logs.delete(at);
    } else if (statuses !== null) this.said.set(birth, statuses);
    this.frame = birth;
    this.statuses = statuses;
    while (this.#isTooMuch(this.said.size * this.layout.numSlots)) forgetOldest(this.said);
  }

  /**
   * @param {number} birth
   * @param {Uint8Array[]} parts the statuses of each layer
   * @param {Uint8Array[]} [moves]
   * @returns {SlotSlice}
   */
  #handOut(birth, parts, moves) {
    const lane = this.layout.lane(birth);
    const rows = parts.map((statuses, layer) => {
      const pending = this.pending.get(key(lane, layer));
      if (pending === undefined) return changedRows(statuses);
      this.pending.delete(key(lane, layer));
      if (moves) moves[layer] = new Uint8Array(); // what comes late does not move
      return changedRows(pending.map((flag, i) => flag | statuses[i]));
    });
    return { birth, lane, rows, moves };
  }

  /**
   * Logs what a late change or snapshot needs, before the slice is applied to `slots`.
   * @param {number} birth
   * @param {number} layer
   * @param {Slots} slots
   * @param {Uint8Array} statuses
   * @param {Uint8Array | null} change
   */
  #remember(birth, layer, slots, statuses, change) {
    const at = key(this.layout.lane(birth), layer);
    if (!this.logs.has(at)) {
      if (!isMissing({ statuses, change }) && !slots.hasUnknown) return;
      const isKnown = slots.conditions.some((condition) => condition !== UNKNOWN);
      this.logs.set(at, { before: isKnown ? slots.copy() : null, since: new Map() });
    }
    this.logs.get(at)?.since.set(birth, { statuses, change });
    while (this.logs.size > 0 && this.#isTooMuch(this.logBytes)) this.#shortenOldestLog();
  }

  /** Gives up what only late packets of earlier segments need, or the whole log. */
  #shortenOldestLog() {
    const [[at, { before, since }]] = this.logs;
    this.logs.delete(at);
    const start = this.layout.segmentStart(this.frame ?? 0);
    const earlier = new Map([...since].filter(([birth]) => birth <= start));
    const later = new Map([...since].filter(([birth]) => birth > start));
    if (earlier.size === 0 || later.size === 0) return;
    const layer = Number(at.split("/")[1]);
    this.logs.set(at, { before: this.#replayed(layer, before, earlier, null), since: later });
  }

  /**
   * Drops the log of a layer of a lane that nothing late can alter.
   * @param {number} lane
   * @param {number} layer
   */
  #dropIfComplete(lane, layer) {
    const log = this.logs.get(key(lane, layer));
    if (log === undefined || isWaiting(log)) return;
    const canFill = log.before?.hasUnknown ?? true;
    if (!canFill || !this.lanes[lane][layer].hasUnknown) this.logs.delete(key(lane, layer));
  }

  /**
   * Applies a log again to a layer of a lane.
   * @param {number} lane
   * @param {number} layer
   * @param {Log} log
   * @param {number | null} checked the birth whose change throws if it does not fit; any other counts
   *   as missing then
   */
  #replay(lane, layer, log, checked) {
    this.lanes[lane][layer] = this.#replayed(layer, log.before, log.since, checked);
    this.logs.set(key(lane, layer), log);
    this.#dropIfComplete(lane, layer);
  }

  /**
   * What `since` makes of the slots `before`; see `#replay`.
   * @param {number} layer
   * @param {Slots | null} before
   * @param {Map<number, Said>} since
   * @param {number | null} checked
   */
  #replayed(layer, before, since, checked) {
    const { slots: counts, numAttributes } = this.layout;
    const slots = before?.copy() ?? new Slots(counts[layer], numAttributes, UNKNOWN);
    for (const [birth, { statuses, change }] of since) {
      let delta;
      try {
        delta = this.#delta(birth, layer, slots, statuses, change);
      } catch (error) {
        if (!(error instanceof FormatError) || birth === checked) throw error;
        delta = this.#delta(birth, layer, slots, statuses, null);
      }
      slots.advance(delta);
    }
    return slots;
  }

  /**
   * @param {number} birth
   * @param {number} layer
   * @param {Slots} slots
   * @param {Uint8Array} statuses
   * @param {Uint8Array | null} bytes
   */
  #delta(birth, layer, slots, statuses, bytes) {
    const { opacityLevels } = this.layout.lattices[layer];
    if (bytes === null) return slots.delta(statuses, null, opacityLevels);
    const counts = [0, 0, 0, 0];
    for (const status of statuses) counts[status]++;
    const change = decodeChange(this.layout, layer, birth, bytes, counts[PREDICTED], counts[NEW]);
    return slots.delta(statuses, change, opacityLevels);
  }

  /**
   * @param {Uint8Array} statuses of a lane
   * @param {number} layer
   */
  #ofLayer(statuses, layer) {
    return statuses.subarray(this.rowEdges[layer], this.rowEdges[layer + 1]);
  }

  /** Bytes kept only because changes, or the snapshots before them, may come late. */
  get logBytes() {
    let total = 0;
    for (const { before, since } of this.logs.values()) {
      total += before?.numBytes ?? 0;
      for (const { statuses, change } of since.values()) {
        total += statuses.length + (change?.length ?? 0);
      }
    }
    return total;
  }

  /** @param {number} logBytes */
  #isTooMuch(logBytes) {
    if (logBytes <= MIN_LOG_BYTES) return false;
    let stateBytes = 0;
    for (const lane of this.lanes) for (const slots of lane) stateBytes += slots.numBytes;
    return logBytes > LOG_SHARE * stateBytes;
  }
}

/** @param {number} lane @param {number} layer */
function key(lane, layer) {
  return `${lane}/${layer}`;
}

/** Whether a change is not here that would say something. @param {Said} said */
function isMissing({ statuses, change }) {
  return change === null && statuses.some((status) => status === PREDICTED || status === NEW);
}

/** Whether any change is missing. @param {Log} log */
function isWaiting({ since }) {
  return [...since.values()].some(isMissing);
}

/** @param {Map<unknown, unknown>} map */
function forgetOldest(map) {
  const [first] = map.keys();
  map.delete(first);
}
