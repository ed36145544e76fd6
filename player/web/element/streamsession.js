import { PlayerWorkers } from "../playback/playerworkers.js";
import { edgeFrame } from "../source/liveedge.js";

/** @typedef {import("../playback/messages.js").FromPlayer} FromPlayer */

/** @type {import("../playback/messages.js").PlayState} before anything of a stream has arrived */
const START = {
  frame: 0,
  endFrame: 0,
  bufferedRanges: [],
  playing: false,
  waiting: true,
  stalls: 0,
  layers: 0,
  rateBps: null,
  receivedBytes: 0,
  decodeMs: 0,
};

/**
 * A stream and the workers that play it, without pictures; see WebPlayer. All messages to the decoding
 * worker are posted here.
 */
export class StreamSession extends EventTarget {
  /** @type {PlayerWorkers | null} null before they start, and while the player is parked */
  workers = null;
  /** @type {import("../playback/messages.js").Source | null} */
  source = null;
  /** @type {import("../playback/messages.js").OpenManifest | null} null until the stream is open */
  manifest = null;
  numFrames = 0;
  /** URL of the stream's folder, with a trailing slash, or of its file. */
  base = "";
  /** @type {import("../playback/messages.js").Files} */
  files = null;
  /** Whether the stream may still grow. */
  live = false;
  /** @type {import("../playback/messages.js").PlayState} */
  state = START;
  /** @type {import("../playback/messages.js").Line | null} as last reported by the worker */
  line = null;
  isSeeking = false;
  /** Counts seeks, so that results of an earlier seek can be told apart. */
  seeks = 0;
  soughtFrame = 0;
  /** Whether the stream plays whenever it may. */
  wantsPlaying = false;
  /** Whether the stream may play now. */
  mayPlay = false;
  /** @type {{ rate: number, loop: boolean, mostLayers: number | null }} */
  #settings = { rate: 1, loop: false, mostLayers: null };

  /**
   * @param {number | null} frame to begin with; null for the stream's own start
   * @param {Worker} sink takes the frames
   */
  startWorkers(frame, sink) {
    if (this.source === null) throw new TypeError("no stream was chosen");
    const start = { frame, seeks: this.seeks, ...this.#settings };
    this.workers = new PlayerWorkers(this.source, start, sink, (data) => this.#onMessage(data));
  }

  stopWorkers() {
    this.workers?.terminate();
    this.workers = null;
    this.line = null;
    this.state = { ...this.state, playing: false };
  }

  /** @param {boolean} playing */
  setPlaying(playing) {
    this.wantsPlaying = playing;
    this.#applyPlaying();
  }

  /** Permits playback, or pauses it until it is permitted again. @param {boolean} mayPlay */
  allow(mayPlay) {
    if (mayPlay === this.mayPlay) return;
    this.mayPlay = mayPlay;
    if (this.wantsPlaying) this.#applyPlaying();
  }

  #applyPlaying() {
    const playing = this.wantsPlaying && this.mayPlay;
    this.workers?.post({ kind: "play", playing });
    this.state = { ...this.state, playing };
    this.dispatch("state");
  }

  /** @param {number} frame */
  seek(frame) {
    this.soughtFrame = Math.max(0, Math.min(this.numFrames - 1, frame));
    this.isSeeking = true;
    this.seeks += 1;
    this.workers?.post({ kind: "seek", frame: this.soughtFrame, seeks: this.seeks });
    this.dispatch("seeking");
  }

  /**
   * Shows a picture near `frame` while the user drags along the track: layer 0 of the nearest segment's
   * first frame. `seek` ends scrubbing.
   * @param {number} frame
   */
  scrub(frame) {
    this.workers?.post({ kind: "scrub", frame });
  }

  /** Whether the stream is one picture, without time. */
  get isStill() {
    return this.manifest !== null && !this.live && this.numFrames === 1;
  }

  /** Seeks forward to the edge of a live stream. */
  seekEdge() {
    const edge = this.manifest === null ? 0 : edgeFrame(this.manifest, this.numFrames);
    if (this.state.frame < edge) this.seek(edge);
  }

  /** @param {number} rate */
  setRate(rate) {
    this.#settings.rate = rate;
    this.workers?.post({ kind: "rate", rate });
  }

  /** @param {boolean} loop */
  setLoop(loop) {
    this.#settings.loop = loop;
    this.workers?.post({ kind: "loop", loop });
  }

  /** Limits the number of layers that show. @param {number} most */
  setLayers(most) {
    this.#settings.mostLayers = most;
    this.workers?.post({ kind: "layers", most });
  }

  /** Makes the worker send the whole current frame to the renderer again. */
  resend() {
    this.workers?.post({ kind: "resend" });
  }

  /** Makes the worker send the current frame as a file, in an event `ply`; see PlayController. */
  requestPly() {
    this.workers?.post({ kind: "ply" });
  }

  /** @param {FromPlayer} data */
  #onMessage(data) {
    switch (data.kind) {
      case "opened": {
        const isFirst = this.manifest === null;
        this.manifest = data.manifest;
        this.numFrames = data.numFrames;
        this.base = data.base;
        this.files = data.files;
        this.live = data.manifest.live;
        this.#applyPlaying();
        this.onOpened(isFirst);
        break;
      }
      case "grown":
        this.numFrames = data.numFrames;
        this.live = data.live;
        this.dispatch("grown");
        break;
      case "state":
        this.state = data;
        this.dispatch("state");
        break;
      case "line":
        this.line = data;
        this.dispatch("line");
        break;
      case "ended":
        this.wantsPlaying = false;
        this.state = { ...this.state, playing: false };
        this.dispatch("ended");
        break;
      case "failed":
        this.fail(data.message);
        break;
      default:
        this.dispatch(data.kind, data.message);
    }
  }

  /**
   * Called when the stream is open.
   * @param {boolean} isFirst whether for the first time @returns {void | Promise<void>}
   */
  onOpened(isFirst) {
    if (isFirst) this.dispatch("opened");
  }

  /** @param {string} message */
  fail(message) {
    this.line = null;
    this.dispatch("failed", message);
  }

  /** @param {string} type @param {unknown} [detail] */
  dispatch(type, detail = null) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }

  /** Ends the play; another stream can be opened. */
  close() {
    this.stopWorkers();
    this.source = null;
    this.manifest = null;
    this.state = START;
    this.live = false;
    this.isSeeking = false;
    this.wantsPlaying = false;
    this.#settings = { rate: 1, loop: false, mostLayers: null };
  }
}
