import { Capture } from "./capture.js";
import { FrameCallbacks } from "./framecallbacks.js";
import { MediaAttributes } from "./mediaattributes.js";

/** @typedef {import("./webplayer.js").WebPlayer} WebPlayer */

/** What a script does with the pictures of a player: their size, callbacks, and where else they go. */
export class PictureInterface extends MediaAttributes {
  /** @type {WebPlayer | null} while the element is in a page */
  player = null;
  #frameCallbacks = new FrameCallbacks();
  /** @type {Capture | null} */
  #capture = null;
  /** @type {(() => void) | null} lets the player rest out of view again */
  #release = null;
  #sizePx = [0, 0];

  /** Width of the picture that is drawn, in pixels; 0 until `loadedmetadata`. */
  get videoWidth() {
    return this.#sizePx[0];
  }

  /** Height of the picture that is drawn, in pixels; 0 until `loadedmetadata`. */
  get videoHeight() {
    return this.#sizePx[1];
  }

  /**
   * Calls back once, after the next frame has been drawn.
   * @param {VideoFrameRequestCallback} callback
   * @returns {number} a handle for `cancelVideoFrameCallback`
   */
  requestVideoFrameCallback(callback) {
    return this.#frameCallbacks.request(callback);
  }

  /** @param {number} handle */
  cancelVideoFrameCallback(handle) {
    this.#frameCallbacks.cancel(handle);
  }

  /**
   * What the canvas shows, without the controls. Throws an InvalidStateError while the element is in no
   * page.
   * @param {number} [fps] at most so many pictures a second; by default every one that is drawn
   * @returns {MediaStream} of one video track; stop it when it is not needed any more
   */
  captureStream(fps) {
    const stream = this.#capturing().stream(fps);
    this.#redraw();
    return stream;
  }

  /**
   * Shows the picture in a window above all others. A person must have pressed something just now.
   * @returns {Promise<PictureInPictureWindow>} rejects as that of HTMLVideoElement
   */
  async requestPictureInPicture() {
    if (this.videoWidth === 0) {
      throw new DOMException("the stream is not open yet", "InvalidStateError");
    }
    const opening = this.#capturing().pictureInPicture();
    this.#redraw();
    return opening;
  }

  /** A player draws off screen too while a page or a window takes its pictures. */
  keepDrawing() {
    if (this.#capture?.isLive) this.#release ??= this.player?.keepAlive() ?? null;
    else {
      this.#release?.();
      this.#release = null;
    }
  }

  /** Takes in the size of the picture, or that there is none. */
  measure() {
    const { player } = this;
    const before = this.#sizePx;
    this.#sizePx = player?.manifest ? player.pictureSizePx : [0, 0];
    const [width, height] = this.#sizePx;
    if (player?.manifest && (width !== before[0] || height !== before[1])) {
      this.queueEvent("resize");
    }
  }

  /** A frame is drawn in this task. @param {number} timeS of the frame */
  runFrameCallbacks(timeS) {
    const [width, height] = this.#sizePx;
    queueMicrotask(() => this.#frameCallbacks.run(timeS, width, height, performance.now()));
  }

  /** Ends what takes pictures of this player. */
  endCapture() {
    this.#capture?.close();
    this.#capture = null;
    this.keepDrawing();
  }

  /** A stream of a canvas has no picture before the next one is drawn. */
  #redraw() {
    this.keepDrawing();
    this.player?.moved();
  }

  #capturing() {
    const { player } = this;
    if (player === null) {
      throw new DOMException("the element is in no page", "InvalidStateError");
    }
    this.#capture ??= new Capture(player.canvas, this);
    return this.#capture;
  }
}
