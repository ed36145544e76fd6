import { StreamSession } from "../element/streamsession.js";
import { startWorker } from "../playback/playerworkers.js";
import { folderUrl } from "../source/addresses.js";
import { copyRows, emptyScene } from "./scene.js";

export { poseOf, rigUp } from "../view/pose.js";

/** @typedef {import("../playback/messages.js").FromKeeper} FromKeeper */
/** @typedef {import("../playback/messages.js").ToKeeper} ToKeeper */
/** @typedef {import("./scene.js").SceneGaussians} SceneGaussians */

/**
 * The description of an open stream: its manifest, and its number of frames so far.
 * @typedef {import("../playback/messages.js").OpenManifest & { numFrames: number }} FeedStream
 */

/**
 * A stream as Gaussians, for scenes that other renderers draw. Network and decoding run in workers.
 *
 *     const feed = new GaussianFeed("https://streams.example.com/stream");
 *     await feed.opened;
 *     feed.play();
 *     // and for each picture:
 *     const slots = feed.take();
 *
 * It plays while the page is visible. Events: `grown` (a live stream has more frames, or has ended),
 * `ended`, `trouble` and `failed` (detail: a message, or null when the trouble is over).
 */
export class GaussianFeed extends StreamSession {
  /** @type {FeedStream | null} null until it is open */
  stream = null;
  /** @type {SceneGaussians} the Gaussian of each slot, as of the last `take`; empty until it is open */
  gaussians = emptyScene(0, 0);
  /** The frame of `gaussians`; -1 before the first. */
  frame = -1;
  #onVisibility = () => this.allow(!document.hidden);
  /** Keeps the scene. */
  #keeper = startWorker(new URL("./feedworker.js", import.meta.url));
  /** @type {FromKeeper | null} */
  #change = null;

  /**
   * Opens the stream whose folder, or file, is at `src`.
   * @param {string} src @param {object} [options]
   * @param {number} [options.maxGaussians] `opened` rejects for a larger stream; 2^22 by default
   * @param {boolean} [options.otherHosts] the stream's objects may be on other hosts
   * @param {RequestCredentials} [options.credentials] whether requests carry cookies, see `fetch`
   * @param {import("../source/transform.js").TransformRequest} [options.transformRequest] changes each request
   */
  constructor(src, options = {}) {
    super();
    this.#keeper.onmessage = (/** @type {MessageEvent<FromKeeper>} */ { data }) =>
      (this.#change = data);
    /** @type {Promise<FeedStream>} rejects with the reason if the stream cannot be opened */
    this.opened = new Promise((resolve, reject) => {
      this.addEventListener("opened", () => resolve(/** @type {FeedStream} */ (this.stream)));
      this.addEventListener("failed", (event) =>
        reject(new Error(/** @type {CustomEvent<string>} */ (event).detail)),
      );
    });
    // A page that does not await the promise gets the event `failed`.
    this.opened.catch(() => {});
    document.addEventListener("visibilitychange", this.#onVisibility);
    this.source = { base: folderUrl(src, document.baseURI), ...options };
    this.startWorkers(null, this.#keeper);
    this.#onVisibility();
  }

  /**
   * Updates `gaussians` to the frame that is due now; to be called for each picture. Returns the slots
   * that have changed, or null if none has.
   * @returns {Uint32Array | null}
   */
  take() {
    if (this.#change === null) return null;
    const { frame, slots, gaussians, seeks } = this.#change;
    this.#change = null;
    this.#post({ take: true });
    copyRows(
      gaussians,
      (i) => i,
      this.gaussians,
      (i) => slots[i],
      slots.length,
    );
    this.frame = frame;
    if (seeks === this.seeks) this.isSeeking = false;
    return slots;
  }

  /** Starts playback, as soon as the stream is open; after the end, from the first frame. */
  play() {
    this.setPlaying(true);
  }

  pause() {
    this.setPlaying(false);
  }

  /** @override Throws an error before the stream is open. @param {number} frame */
  seek(frame) {
    if (this.stream === null)
      throw new Error("the stream is not open yet; await feed.opened first");
    super.seek(frame);
  }

  /** @override @param {boolean} isFirst */
  onOpened(isFirst) {
    const { manifest, numFrames } = this;
    if (manifest === null) return;
    this.gaussians = emptyScene(manifest.numGs, manifest.shDegree);
    this.#post({ manifest });
    this.stream = { ...manifest, numFrames };
    super.onOpened(isFirst);
  }

  /** @override @param {string} type @param {unknown} [detail] */
  dispatch(type, detail) {
    const { stream, numFrames, live } = this;
    if (type === "grown" && stream !== null) Object.assign(stream, { numFrames, live });
    super.dispatch(type, detail);
  }

  /** @override @param {string} message */
  fail(message) {
    this.close();
    super.fail(message);
  }

  /** @override Ends the play and its workers. */
  close() {
    document.removeEventListener("visibilitychange", this.#onVisibility);
    super.close();
  }

  /** @param {ToKeeper} message */
  #post(message) {
    this.#keeper.postMessage(message);
  }
}
