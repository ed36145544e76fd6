import { Capture } from "./capture.js";
import { FrameCallbacks } from "./framecallbacks.js";
import { MediaAttributes } from "./mediaattributes.js";

/** @typedef {import("./webplayer.js").WebPlayer} WebPlayer */

/** Scripting interface to the player's pictures: their size, frame callbacks, and capture. */
export class PictureInterface extends MediaAttributes {
  /** @type {WebPlayer | null} while the element is in a page */
  player = null;
  #frameCallbacks = new FrameCallbacks();
  /** @type {Capture | null} */
  #capture = null;
  /** @type {import("./pictureinpicture.js").PictureInPicture | null} */
  #window = null;
  /** @type {(() => void) | null} lets the player pause out of view again */
  #release = null;
  #sizePx = [0, 0];

  /** Width of the drawn picture in pixels; 0 until `loadedmetadata`. */
  get videoWidth() {
    return this.#sizePx[0];
  }

  /** Height of the drawn picture in pixels; 0 until `loadedmetadata`. */
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
   * Captures the canvas, without the controls. Throws an InvalidStateError while the element is not in a
   * page.
   * @param {number} [fps] maximum number of pictures per second; by default every drawn picture
   * @returns {MediaStream} with one video track; stop it when it is no longer needed
   */
  captureStream(fps) {
    const stream = this.#capturing().stream(fps);
    this.#redraw();
    return stream;
  }

  /**
   * Shows the picture in a window above all others. Needs a recent user gesture.
   * @returns {Promise<PictureInPictureWindow>} rejects like the method of HTMLVideoElement
   */
  async requestPictureInPicture() {
    if (this.videoWidth === 0) {
      throw new DOMException("the stream is not open yet", "InvalidStateError");
    }
    const capture = this.#capturing();
    const { PictureInPicture } = await import("./pictureinpicture.js");
    this.#window ??= new PictureInPicture(capture, this);
    const opening = this.#window.open();
    this.#redraw();
    return opening;
  }

  /** @protected Keeps the player drawing off screen while a capture or picture in picture uses its pictures. */
  keepDrawing() {
    if (this.#capture?.isLive) this.#release ??= this.player?.keepAlive() ?? null;
    else {
      this.#release?.();
      this.#release = null;
    }
  }

  /** @protected Updates the size of the picture, or notes that there is none. */
  measure() {
    const { player } = this;
    const before = this.#sizePx;
    this.#sizePx = player?.manifest ? player.pictureSizePx : [0, 0];
    const [width, height] = this.#sizePx;
    if (player?.manifest && (width !== before[0] || height !== before[1])) {
      this.queueEvent("resize");
    }
  }

  /** @protected Runs the frame callbacks; a frame is drawn in this task. @param {number} timeS of the frame */
  runFrameCallbacks(timeS) {
    const [width, height] = this.#sizePx;
    queueMicrotask(() => this.#frameCallbacks.run(timeS, width, height, performance.now()));
  }

  /** @protected Ends all captures of this player. */
  endCapture() {
    this.#window?.close();
    this.#window = null;
    this.#capture?.close();
    this.#capture = null;
    this.keepDrawing();
  }

  /** Draws again: a captured stream has no picture until the canvas is next drawn. */
  #redraw() {
    this.keepDrawing();
    this.player?.moved();
  }

  #capturing() {
    const { player } = this;
    if (player === null) {
      throw new DOMException("the element is in no page", "InvalidStateError");
    }
    this.#capture ??= new Capture(player.canvas);
    return this.#capture;
  }
}
