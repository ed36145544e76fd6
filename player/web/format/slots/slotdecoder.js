/** Decodes skip maps, changes and keyframes to the state of the slots (FORMAT.md, section 7). */

import { LOG_SHARE, MIN_LOG_BYTES, NEW, PREDICTED, UNKNOWN } from "../../constants.js";
import { decodeChange, decodeKeyframe, decodeSkipMap, SkipMapHistory } from "./chunks.js";
import { corrupt, FormatError } from "../bytes.js";
import { changedRows, movesOf, Slots } from "./slots.js";

/**
 * The statuses of a slice for a layer, and the bytes of its change; null if the change is missing.
 * @typedef {{ statuses: Uint8Array, change: Uint8Array | null }} Said
 */

/**
 * The history of a layer of a lane since data went missing: the slices to apply again when it arrives.
 * @typedef {object} Log
 * @property {Slots | null} before the slots before those slices; null if all were unknown
 * @property {Map<number, Said>} since by birth, every slice of the lane since then
 */

/**
 * The changes in a lane since it was last returned.
 * @typedef {object} SlotSlice
 * @property {number} birth @property {number} lane
 * @property {Uint32Array[]} rows the changed slots of each layer
 * @property {Uint8Array[]} [moves] their transitions, see `movesOf`; an empty array for a layer where they
 *   are unknown; absent for a whole window, or for a slice that does not show
 */

/**
 * The state of the slots of layers 0 .. numLayers - 1, from one frame to the next.
 *
 * Load the keyframes of a segment's first frame, then apply the slices born after it one by one. To
 * seek, make a new decoder. A call that throws leaves the state unchanged. Bytes that are passed in are
 * kept as long as a late packet may need them.
 */
export class SlotDecoder {
  /** First slot of each layer within a lane. */
  rowEdges = [0];
  /** @type {number | null} birth of the last applied slice */
  frame = null;
  /** @type {Map<string, Log>} by lane and layer, the oldest first */
  logs = new Map();
  /** @type {Map<number, Uint8Array>} statuses of this segment's slices, for late keyframes */
  said = new Map();
  /** @type {Map<string, Uint8Array>} by lane and layer, slots altered by late bytes since the last slice */
  pending = new Map();

  /** @param {import("../gaussians.js").SlotLayout} layout @param {number} [numLayers] */
  constructor(layout, numLayers = layout.numLayers) {
    this.layout = layout;
    /** @type {number} */ this.numLayers = numLayers;
    for (const count of layout.slots)
      this.rowEdges.push(this.rowEdges[this.rowEdges.length - 1] + count);
    /** @type {Slots[][]} by lane and layer */
    this.lanes = Array.from({ length: layout.swinSize }, () => this.#unknownLane());
    this.history = new SkipMapHistory(layout);
  }

  #unknownLane() {
    const counts = this.layout.slots.slice(0, this.numLayers);
    return counts.map((count) => new Slots(count, this.layout.numAttributes, UNKNOWN));
  }

  /**
   * Loads a keyframe, which replaces the state of its layer. It may arrive late.
   * @param {Uint8Array} bytes @param {number} [layer] the expected one
   * @param {number} [frame] the expected one @returns {boolean} whether it was used
   */
  load(bytes, layer, frame) {
    const keyframe = decodeKeyframe(this.layout, bytes);
    const wanted =
      frame ?? (this.frame === null ? undefined : this.layout.segmentStart(this.frame));
    if (wanted !== undefined && keyframe.frame !== wanted)
      throw corrupt(`keyframe: of frame ${keyframe.frame} where that of ${wanted} belongs`);
    if (layer !== undefined && keyframe.layer !== layer)
      throw corrupt(`keyframe: of layer ${keyframe.layer} where that of ${layer} belongs`);
    if (keyframe.layer >= this.numLayers) return false;
    if (this.frame === null) this.frame = keyframe.frame;
    if (keyframe.frame > this.frame)
      throw new RangeError("the slices have not come to the keyframe");
    if (keyframe.frame !== this.layout.segmentStart(this.frame)) return false;
    const { swinSize } = this.layout;
    let used = false;
    for (const [i, slots] of keyframe.lanes.entries()) {
      const birth = keyframe.frame - swinSize + 1 + i;
      const since = /** @type {number[]} */ ([]);
      for (let b = birth + swinSize; b <= this.frame; b += swinSize) since.push(b);
      const lane = this.layout.lane(birth);
      if (keyframe.frame === this.frame || this.#canUseLate(lane, keyframe.layer, since)) {
        this.#beginAnew(lane, keyframe.layer, slots, since);
        used = true;
      }
    }
    return used;
  }

  /**
   * Whether a keyframe from before `births` improves a layer of a lane: some slots were already unknown
   * before `births`, and no skip map is missing.
   * @param {number} lane @param {number} layer @param {number[]} births
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
   * Replaces a layer of a lane by `slots`, and applies the known slices of `births`.
   * @param {number} lane @param {number} layer @param {Slots} slots @param {number[]} births
   */
  #beginAnew(lane, layer, slots, births) {
    const known = this.logs.get(key(lane, layer));
    /** @type {Map<number, Said>} */
    const since = new Map();
    for (const birth of births) {
      const statuses = this.said.get(birth);
      if (statuses === undefined) throw new Error(`the skip map of ${birth} is not here`);
      const change = known?.since.get(birth)?.change ?? null;
      since.set(birth, { statuses: this.#ofLayer(statuses, layer), change });
    }
    this.logs.delete(key(lane, layer));
    this.#replay(lane, layer, { before: slots, since }, null);
    this.pending.set(key(lane, layer), new Uint8Array(slots.count).fill(1));
  }

  /**
   * Applies the slice born at `birth`, which must follow the last one.
   * @param {number} birth
   * @param {Uint8Array | null} skipMap null if it is missing: all slots of the lane become unknown
   * @param {(Uint8Array | null)[]} changes of layers 0, 1, ...; null for a missing one, which may arrive
   *   late; changes of further layers are not expected
   * @param {boolean} [shows] whether the slice itself shows, and so tells how its slots move
   * @returns {SlotSlice}
   */
  apply(birth, skipMap, changes, shows = false) {
    if (this.frame === null || birth !== this.frame + 1)
      throw new RangeError(`the slice born at ${birth} does not follow ${this.frame}`);
    if (skipMap === null || !this.history.isReadable(birth)) return this.#loseLane(birth);
    const lane = this.layout.lane(birth);
    const statuses = decodeSkipMap(this.layout, birth, skipMap, this.history.of(birth));
    const parts = this.lanes[lane].map((_, layer) => this.#ofLayer(statuses, layer));
    const deltas = this.lanes[lane].map((slots, layer) =>
      this.#delta(birth, layer, slots, parts[layer], changes[layer] ?? null),
    );
    /** @type {Uint8Array[] | undefined} */
    const moves = shows ? [] : undefined;
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
   * Whether `apply` would accept a change; otherwise throws a FormatError.
   * @param {number} birth @param {Uint8Array | null} skipMap @param {number} layer @param {Uint8Array} change
   */
  takes(birth, skipMap, layer, change) {
    if (skipMap === null || !this.history.isReadable(birth)) return true;
    const statuses = decodeSkipMap(this.layout, birth, skipMap, this.history.of(birth));
    const slots = this.lanes[this.layout.lane(birth)][layer];
    this.#delta(birth, layer, slots, this.#ofLayer(statuses, layer), change);
    return true;
  }

  /**
   * Applies a change that was missing when its slice was applied.
   * @param {number} birth @param {number} layer @param {Uint8Array} bytes
   * @returns {boolean} whether it was used; the lane's next slice then includes the altered slots
   */
  late(birth, layer, bytes) {
    const lane = this.layout.lane(birth);
    const log = this.logs.get(key(lane, layer));
    const said = log?.since.get(birth);
    if (log === undefined || said === undefined || !isMissing(said)) return false;
    const since = new Map(log.since).set(birth, { statuses: said.statuses, change: bytes });
    this.#replay(lane, layer, { before: log.before, since }, birth);
    const altered = this.pending.get(key(lane, layer)) ?? new Uint8Array(said.statuses.length);
    for (const [known, { statuses }] of since)
      if (known >= birth) statuses.forEach((status, i) => (altered[i] |= status));
    this.pending.set(key(lane, layer), altered);
    return true;
  }

  /**
   * All slots of the lane of `birth`, for a renderer without earlier data.
   * @param {number} birth @returns {SlotSlice}
   */
  whole(birth) {
    const lane = this.layout.lane(birth);
    const rows = this.lanes[lane].map((slots) => Uint32Array.from(slots.conditions, (_, i) => i));
    return { birth, lane, rows };
  }

  /** The whole window of the last applied frame; later results of `apply` continue from it. */
  handOut() {
    this.pending.clear();
    const { swinSize } = this.layout;
    const frame = this.frame ?? 0;
    return [...Array(swinSize).keys()].map((i) => this.whole(frame - swinSize + 1 + i));
  }

  /** @param {number} birth @returns {SlotSlice} */
  #loseLane(birth) {
    const lane = this.layout.lane(birth);
    this.lanes[lane] = this.#unknownLane();
    for (let layer = 0; layer < this.numLayers; layer++) this.logs.delete(key(lane, layer));
    this.history.note(birth, null);
    this.#goOn(birth, null);
    for (let layer = 0; layer < this.numLayers; layer++) this.pending.delete(key(lane, layer));
    return this.whole(birth);
  }

  /** @param {number} birth @param {Uint8Array | null} statuses null: the skip map is missing */
  #goOn(birth, statuses) {
    if (birth === this.layout.segmentStart(birth)) {
      this.said.clear();
      // Keyframes of the previous segment can no longer be used, so only logs that wait for changes remain.
      for (const [at, log] of this.logs) if (!isWaiting(log)) this.logs.delete(at);
    } else if (statuses !== null) this.said.set(birth, statuses);
    this.frame = birth;
    while (this.#isTooMuch(this.said.size * this.layout.numSlots)) forgetOldest(this.said);
  }

  /**
   * @param {number} birth @param {Uint8Array[]} parts the statuses of each layer
   * @param {Uint8Array[]} [moves] @returns {SlotSlice}
   */
  #handOut(birth, parts, moves) {
    const lane = this.layout.lane(birth);
    const rows = parts.map((statuses, layer) => {
      const pending = this.pending.get(key(lane, layer));
      if (pending === undefined) return changedRows(statuses);
      this.pending.delete(key(lane, layer));
      if (moves) moves[layer] = new Uint8Array(); // late changes appear without motion
      return changedRows(pending.map((flag, i) => flag | statuses[i]));
    });
    return { birth, lane, rows, moves };
  }

  /**
   * Logs the data that a late change or keyframe needs, before the slice is applied to `slots`.
   * @param {number} birth @param {number} layer @param {Slots} slots @param {Uint8Array} statuses
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

  /** Drops the part of the oldest log that only late packets of earlier segments need, or all of it. */
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

  /** Drops the log of a layer of a lane if no late data can alter it. @param {number} lane @param {number} layer */
  #dropIfComplete(lane, layer) {
    const log = this.logs.get(key(lane, layer));
    if (log === undefined || isWaiting(log)) return;
    const canFill = log.before?.hasUnknown ?? true;
    if (!canFill || !this.lanes[lane][layer].hasUnknown) this.logs.delete(key(lane, layer));
  }

  /**
   * Applies a log again to a layer of a lane.
   * @param {number} lane @param {number} layer @param {Log} log
   * @param {number | null} checked the birth whose change throws if it does not fit; any other change that
   *   does not fit counts as missing
   */
  #replay(lane, layer, log, checked) {
    this.lanes[lane][layer] = this.#replayed(layer, log.before, log.since, checked);
    this.logs.set(key(lane, layer), log);
    this.#dropIfComplete(lane, layer);
  }

  /**
   * The slots after applying `since` to `before`; see `#replay`.
   * @param {number} layer @param {Slots | null} before @param {Map<number, Said>} since
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
   * @param {number} birth @param {number} layer @param {Slots} slots @param {Uint8Array} statuses
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

  /** @param {Uint8Array} statuses of a lane @param {number} layer */
  #ofLayer(statuses, layer) {
    return statuses.subarray(this.rowEdges[layer], this.rowEdges[layer + 1]);
  }

  /** Bytes kept only because changes, or the keyframes before them, may arrive late. */
  get logBytes() {
    let total = 0;
    for (const { before, since } of this.logs.values()) {
      total += before?.numBytes ?? 0;
      for (const { statuses, change } of since.values())
        total += statuses.length + (change?.length ?? 0);
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

/** Whether a non-empty change is missing. @param {Said} said */
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
