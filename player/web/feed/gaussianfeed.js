import { folderUrl } from "../source/addresses.js";
import { preloadSource } from "../playback/preload.js";
import { requestPort } from "../playback/requestport.js";
import { startWorker } from "../playback/startworker.js";
import { copyRows, emptyScene } from "./scene.js";

export { poseOf, rigUp } from "../view/pose.js";

/** @typedef {import("./scene.js").SceneGaussians} SceneGaussians */

/**
 * The description of an open stream: its manifest, and its number of frames so far.
 * @typedef {Omit<import("../format/manifest.js").Manifest, "layout"> & { numFrames: number }} FeedStream
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
export class GaussianFeed extends EventTarget {
  /** @type {FeedStream | null} null until it is open */
  stream = null;
  /** @type {SceneGaussians} the Gaussian of each slot, as of the last `take`; empty until it is open */
  gaussians = emptyScene(0, 0);
  /** The frame of `gaussians`; -1 before the first. */
  frame = -1;
  /** Whether `gaussians` still belong to a frame before the last seek. */
  isSeeking = false;
  #seeks = 0;
  #wantsPlaying = false;
  #onVisibility = () => this.#applyPlaying();
  /** @type {(import("./scene.js").SceneChange & { seeks: number }) | null} */
  #change = null;

  /**
   * Opens the stream whose folder, or file, is at `src`.
   * @param {string} src
   * @param {object} [options]
   * @param {number} [options.maxGaussians] `opened` rejects for a larger stream; 2^22 by default
   * @param {boolean} [options.otherHosts] the stream's objects may be on other hosts
   * @param {RequestCredentials} [options.credentials] whether requests carry cookies, see `fetch`
   * @param {import("../source/transform.js").TransformRequest} [options.transformRequest] changes each request
   */
  constructor(src, { maxGaussians, otherHosts, credentials, transformRequest } = {}) {
    super();
    const base = folderUrl(src, document.baseURI);
    const channel = new MessageChannel();
    this.player = startWorker(new URL("../playback/playworker.js", import.meta.url));
    preloadSource(base);
    this.keeper = startWorker(new URL("./feedworker.js", import.meta.url));
    this.keeper.onmessage = ({ data }) => (this.#change = data);
    /** @type {Promise<FeedStream>} rejects with the reason if the stream cannot be opened */
    this.opened = new Promise((resolve, reject) => {
      this.addEventListener("failed", (event) =>
        reject(new Error(/** @type {CustomEvent} */ (event).detail)),
      );
      this.player.onmessage = ({ data }) => {
        if (data.kind === "opened") resolve(this.#open(data, channel.port2));
        else if (data.kind === "grown") this.#grow(data);
        else if (data.kind === "failed") this.#fail(data.message);
        else if (data.kind === "ended" || data.kind === "trouble")
          this.#say(data.kind, data.message);
        if (data.kind === "ended") this.#wantsPlaying = false;
      };
    });
    // A page that does not await the promise gets the event `failed`.
    this.opened.catch(() => {});
    for (const worker of [this.player, this.keeper]) {
      worker.onerror = ({ message }) =>
        this.#fail(`The player failed: ${message ?? "one of its scripts was not loaded"}`);
    }
    document.addEventListener("visibilitychange", this.#onVisibility);
    const { port1 } = channel;
    const asked = requestPort(transformRequest, (message) => this.#fail(message));
    const wish = { base, maxGaussians, otherHosts, credentials, transformRequest: asked };
    const ports = asked === undefined ? [port1] : [port1, asked];
    this.player.postMessage({ kind: "open", ...wish, port: port1 }, ports);
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
    this.keeper.postMessage({});
    copyRows(
      gaussians,
      (i) => i,
      this.gaussians,
      (i) => slots[i],
      slots.length,
    );
    this.frame = frame;
    if (seeks === this.#seeks) this.isSeeking = false;
    return slots;
  }

  /** Starts playback; after the end, from the first frame. Throws an error before the stream is open. */
  play() {
    this.#play(true);
  }

  pause() {
    this.#play(false);
  }

  /** @param {boolean} playing */
  #play(playing) {
    this.#checkOpen();
    this.#wantsPlaying = playing;
    this.#applyPlaying();
  }

  #applyPlaying() {
    const playing = this.#wantsPlaying && !document.hidden;
    this.player.postMessage({ kind: "play", playing });
  }

  /** @param {number} frame */
  seek(frame) {
    const seeks = this.#seeks + 1;
    this.#post({ kind: "seek", frame, seeks });
    this.#seeks = seeks;
    this.isSeeking = true;
  }

  /** @param {number} rate 1 is normal speed */
  setRate(rate) {
    this.#post({ kind: "rate", rate });
  }

  /** @param {boolean} loop */
  setLoop(loop) {
    this.#post({ kind: "loop", loop });
  }

  /** Limits the number of layers that show. @param {number} most */
  setLayers(most) {
    this.#post({ kind: "layers", most });
  }

  /** Ends the play and its workers. */
  close() {
    document.removeEventListener("visibilitychange", this.#onVisibility);
    this.player.terminate();
    this.keeper.terminate();
  }

  /**
   * @param {{ manifest: Omit<FeedStream, "numFrames"> & { lattices: unknown }, numFrames: number }} data
   * @param {MessagePort} port
   * @returns {FeedStream}
   */
  #open({ manifest, numFrames }, port) {
    this.gaussians = emptyScene(manifest.numGs, manifest.shDegree);
    this.keeper.postMessage({ manifest, port }, [port]);
    this.stream = { ...manifest, numFrames };
    return this.stream;
  }

  /** @param {{ numFrames: number, live: boolean }} data */
  #grow({ numFrames, live }) {
    if (this.stream !== null) Object.assign(this.stream, { numFrames, live });
    this.#say("grown");
  }

  /** @param {string} message */
  #fail(message) {
    this.close();
    this.#say("failed", message);
  }

  /** @param {object} message */
  #post(message) {
    this.#checkOpen();
    this.player.postMessage(message);
  }

  #checkOpen() {
    if (this.stream === null)
      throw new Error("the stream is not open yet; await feed.opened first");
  }

  /**
   * @param {string} type
   * @param {string | null} [detail]
   */
  #say(type, detail = null) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }
}
