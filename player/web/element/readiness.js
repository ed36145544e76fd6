/** What a media element says about its data: ranges of time, `networkState` and `readyState`. */

/**
 * Ranges of time in seconds, ascending and disjoint, like `TimeRanges` of HTML, which a script cannot construct.
 * @implements {TimeRanges}
 */
export class SecondRanges {
  #ranges;

  /** @param {[startS: number, endS: number][]} ranges */
  constructor(ranges) {
    this.#ranges = ranges;
  }

  get length() {
    return this.#ranges.length;
  }

  /** Seconds. Throws an IndexSizeError. @param {number} index */
  start(index) {
    return this.#at(index)[0];
  }

  /** Seconds. Throws an IndexSizeError. @param {number} index */
  end(index) {
    return this.#at(index)[1];
  }

  /** @param {number} index */
  #at(index) {
    const range = this.#ranges[index];
    if (range === undefined) {
      const message = `there is no range ${index} of ${this.length}`;
      throw new DOMException(message, "IndexSizeError");
    }
    return range;
  }
}

/** A set of frames, kept as ascending, disjoint ranges. */
export class FrameRanges {
  /** @type {[firstFrame: number, endFrame: number][]} */
  ranges = [];

  /** Adds the frames [firstFrame, endFrame). @param {number} firstFrame @param {number} endFrame */
  add(firstFrame, endFrame) {
    if (endFrame <= firstFrame) return;
    const before = this.ranges.filter(([, end]) => end < firstFrame);
    const after = this.ranges.filter(([first]) => first > endFrame);
    const touched = this.ranges.slice(before.length, this.ranges.length - after.length);
    const first = Math.min(firstFrame, ...touched.map((range) => range[0]));
    const end = Math.max(endFrame, ...touched.map((range) => range[1]));
    this.ranges = [...before, [first, end], ...after];
  }

  /** The ranges in seconds. @param {number} fps */
  inSeconds(fps) {
    return new SecondRanges(this.ranges.map(([first, end]) => [first / fps, end / fps]));
  }
}

/** `networkState` of media elements. */
export const NETWORK = { EMPTY: 0, IDLE: 1, LOADING: 2, NO_SOURCE: 3 };

/** `readyState` of media elements. */
export const READY = { NOTHING: 0, METADATA: 1, CURRENT: 2, FUTURE: 3, ENOUGH: 4 };

/** Seconds between two `progress` events, as the HTML standard asks for. */
const PROGRESS_S = 0.35;

/** Seconds without new bytes, with a picture to show, after which the source counts as suspended. */
const QUIET_S = 0.5;

/** Seconds without new bytes while data is missing before `stalled` fires, as in the HTML standard. */
const STALLED_S = 3;

/** Seconds of media ahead of the shown frame that count as enough to play through. */
const ENOUGH_S = 2;

/**
 * The part of the playback state that loading depends on.
 * @typedef {object} LoadState
 * @property {number} fps
 * @property {number} frame the worker's frame
 * @property {number} endFrame the first frame that is missing
 * @property {number} numFrames
 * @property {boolean} live whether more frames may follow
 * @property {boolean} waiting whether playback waits for data
 * @property {boolean} playing whether the element is not paused
 * @property {boolean} isShown whether a frame of the stream has been drawn
 * @property {boolean} isSeeking whether the sought frame has not been drawn yet
 * @property {number} receivedBytes so far
 */

/**
 * `readyState` and `networkState` of a media element, and the events for their changes, in the order of
 * https://html.spec.whatwg.org/multipage/media.html#ready-states. It reads no clock: callers pass the time.
 */
export class Readiness {
  ready = READY.NOTHING;
  network = NETWORK.EMPTY;
  #hasLoaded = false;
  #isStalled = false;
  #receivedBytes = 0;
  /** Time of the last arrival of bytes. */
  #receivedS = 0;
  #progressS = -Infinity;

  /** Returns to the state in which nothing is loaded and nothing is loading. */
  reset() {
    this.ready = READY.NOTHING;
    this.network = NETWORK.EMPTY;
    this.#hasLoaded = false;
    this.#isStalled = false;
    this.#receivedBytes = 0;
    this.#progressS = -Infinity;
  }

  /** A stream is selected. @returns {string[]} events */
  select() {
    this.network = NETWORK.LOADING;
    return ["loadstart"];
  }

  /** Fetching stops for now: enough is buffered, or nothing is wanted yet. @returns {string[]} events */
  suspend() {
    if (this.network !== NETWORK.LOADING) return [];
    this.network = NETWORK.IDLE;
    return ["suspend"];
  }

  /** The manifest has arrived. @param {number} nowS @returns {string[]} events */
  open(nowS) {
    this.ready = READY.METADATA;
    this.#receivedS = nowS;
    return ["loadedmetadata"];
  }

  /**
   * Updates both states from the playback state at `nowS`.
   * @param {LoadState} state @param {number} nowS @returns {string[]} events
   */
  update(state, nowS) {
    if (this.ready === READY.NOTHING) return [];
    return [...this.#load(state, nowS), ...this.#raise(readyOf(state), state.playing)];
  }

  /** @param {LoadState} state @param {number} nowS */
  #load({ receivedBytes, isShown, waiting }, nowS) {
    /** @type {string[]} */
    const events = [];
    if (receivedBytes !== this.#receivedBytes) {
      this.#receivedBytes = receivedBytes;
      this.#receivedS = nowS;
      this.#isStalled = false;
      this.network = NETWORK.LOADING;
      if (nowS - this.#progressS >= PROGRESS_S) {
        this.#progressS = nowS;
        events.push("progress");
      }
      return events;
    }
    const quietS = nowS - this.#receivedS;
    if (this.network !== NETWORK.LOADING) return events;
    if (isShown && !waiting) {
      // The last bytes may have arrived too soon after a `progress` to be reported.
      if (quietS >= QUIET_S) events.push("progress", ...this.suspend());
    } else if (quietS >= STALLED_S && !this.#isStalled) {
      this.#isStalled = true;
      events.push("stalled");
    }
    return events;
  }

  /** @param {number} ready @param {boolean} playing */
  #raise(ready, playing) {
    const before = this.ready;
    this.ready = ready;
    const events = /** @type {string[]} */ ([]);
    if (before >= READY.FUTURE && ready < READY.FUTURE && playing)
      events.push("timeupdate", "waiting");
    if (ready >= READY.CURRENT && !this.#hasLoaded) {
      this.#hasLoaded = true;
      events.push("loadeddata");
    }
    if (before < READY.FUTURE && ready >= READY.FUTURE) {
      events.push("canplay");
      if (playing) events.push("playing");
    }
    if (before < READY.ENOUGH && ready === READY.ENOUGH) events.push("canplaythrough");
    return events;
  }
}

/** @param {LoadState} state */
function readyOf({ fps, frame, endFrame, numFrames, live, waiting, playing, isShown, isSeeking }) {
  if (!isShown || isSeeking) return READY.METADATA;
  const isWhole = !live && endFrame >= numFrames;
  if ((playing && waiting) || !(isWhole || endFrame > frame + 1)) return READY.CURRENT;
  return isWhole || endFrame - frame >= ENOUGH_S * fps ? READY.ENOUGH : READY.FUTURE;
}
