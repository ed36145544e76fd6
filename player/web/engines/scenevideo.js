import { GaussianFeed } from "../feed/gaussianfeed.js";
import { poseOf } from "../view/pose.js";

/** @typedef {import("../feed/gaussianfeed.js").FeedStream} FeedStream */

/**
 * Options of a video in a scene.
 * @typedef {object} SceneVideoOptions
 * @property {string} url of the stream's folder
 * @property {boolean} [autoplay] plays once it is open; true by default
 * @property {boolean} [loop] starts again at the end; true by default
 * @property {number} [maxGaussians] a stream with more is refused; 2^22 by default
 * @property {boolean} [otherHosts] the stream's objects may be on other hosts than its manifest
 * @property {RequestCredentials} [credentials] whether requests carry cookies, see `fetch`
 * @property {import("../source/transform.js").TransformRequest} [transformRequest] changes each request
 */

/**
 * A camera's pose and lens, in the convention of engines with y up and -z ahead.
 * @typedef {object} SceneCamera
 * @property {[number, number, number]} position metres
 * @property {number[]} axes of the camera in the world: right, up and backward, three numbers each
 * @property {number} fovDeg vertical
 * @property {number} nearM metres
 */

/**
 * A stream that plays by itself in the scene of another renderer. Its interface follows media elements.
 *
 * Events: `ended`, `trouble` and `failed` (detail: a message, or null when the trouble is over).
 */
export class SceneVideo extends EventTarget {
  #feed;
  #loop = true;
  #rate = 1;

  /** @param {SceneVideoOptions} options */
  constructor({ url, autoplay = true, loop = true, ...options }) {
    super();
    this.#feed = new GaussianFeed(url, options);
    /** @type {Promise<FeedStream>} rejects with the reason if the stream cannot be opened */
    this.opened = this.#feed.opened;
    this.loop = loop;
    this.#feed.setPlaying(autoplay);
    for (const type of ["ended", "trouble", "failed"]) {
      this.#feed.addEventListener(type, (event) => {
        const { detail } = /** @type {CustomEvent<string | null>} */ (event);
        this.dispatchEvent(new CustomEvent(type, { detail }));
      });
    }
  }

  /** The stream's description; null until it is open. */
  get stream() {
    return this.#feed.stream;
  }

  /** The Gaussian of each slot, as of the last `take`. */
  get gaussians() {
    return this.#feed.gaussians;
  }

  get paused() {
    return !this.#feed.wantsPlaying;
  }

  /** Seconds; NaN until it is open. */
  get duration() {
    const { stream } = this;
    return stream ? stream.numFrames / stream.fps : NaN;
  }

  /** Time of the frame that shows, or is being sought, in seconds. */
  get currentTime() {
    const { stream } = this;
    const { isSeeking, soughtFrame, frame } = this.#feed;
    return stream ? (isSeeking ? soughtFrame : Math.max(0, frame)) / stream.fps : 0;
  }

  /** Throws an error if the stream is not open yet. */
  set currentTime(seconds) {
    const { stream } = this;
    if (!Number.isFinite(seconds)) throw new TypeError(`currentTime: ${seconds} is not a time`);
    if (stream === null) throw new Error("the stream is not open yet; await opened first");
    this.#feed.seek(Math.round(seconds * stream.fps));
  }

  get loop() {
    return this.#loop;
  }

  set loop(value) {
    this.#loop = value;
    this.#feed.setLoop(value);
  }

  /** 1 is normal speed. */
  get playbackRate() {
    return this.#rate;
  }

  set playbackRate(rate) {
    if (!(rate > 0 && rate < Infinity))
      throw new RangeError(`playbackRate: ${rate} is not a positive number`);
    this.#rate = rate;
    this.#feed.setRate(rate);
  }

  /** Starts playback as soon as the stream is open; after the end, from the first frame. */
  play() {
    this.#feed.play();
  }

  pause() {
    this.#feed.pause();
  }

  /**
   * Updates `gaussians` to the frame that is due; to be called for each picture.
   * @returns {Uint32Array | null} the slots that have changed, if any
   */
  take() {
    return this.#feed.take();
  }

  /** The stream's default camera. */
  async defaultCamera() {
    const { defaultCamera, nearM } = await this.opened;
    return sceneCamera(defaultCamera, nearM);
  }

  /** Ends the play and its workers. */
  dispose() {
    this.#feed.close();
  }
}

/** @param {import("../format/manifest.js").Camera} camera @param {number} nearM @returns {SceneCamera} */
function sceneCamera(camera, nearM) {
  const { position, right, down, forward } = poseOf(camera);
  const [up, backward] = [down, forward].map((axis) => axis.map((value) => -value));
  const fovRad = 2 * Math.atan(camera.heightPx / 2 / camera.fyPx);
  return {
    position: [position[0], position[1], position[2]],
    axes: [...right, ...up, ...backward],
    fovDeg: (180 / Math.PI) * fovRad,
    nearM,
  };
}
