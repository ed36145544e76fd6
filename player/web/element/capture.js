/**
 * The canvas's picture as a video stream, for recorders and peers, and in a picture-in-picture window.
 */
export class Capture {
  #canvas;
  #host;
  /** @type {Set<MediaStream>} streams whose tracks have not been stopped */
  #streams = new Set();
  /** @type {HTMLVideoElement | null} plays the picture in picture */
  #video = null;

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {HTMLElement & { play?: () => Promise<void>, pause?: () => void }} host fires
   *   `enterpictureinpicture` and `leavepictureinpicture`
   */
  constructor(canvas, host) {
    this.#canvas = canvas;
    this.#host = host;
  }

  /** Whether a stream is still in use, that is, has a track that was not stopped. */
  get isLive() {
    for (const stream of this.#streams) {
      if (!stream.active) this.#streams.delete(stream);
    }
    return this.#streams.size > 0;
  }

  /**
   * @param {number} [fps] maximum number of pictures per second; by default every drawn picture
   * @returns {MediaStream} with one video track
   */
  stream(fps) {
    const stream = this.#canvas.captureStream(fps);
    this.#streams.add(stream);
    return stream;
  }

  /**
   * Shows the picture in a window above all others. Needs a recent user gesture.
   * Rejects like `HTMLVideoElement.requestPictureInPicture`.
   * @returns {Promise<PictureInPictureWindow>}
   */
  async pictureInPicture() {
    if (this.#video !== null) return this.#video.requestPictureInPicture();
    if (!document.pictureInPictureEnabled) {
      const message = "this browser has no picture in picture, or this page may not use it";
      throw new DOMException(message, "NotSupportedError");
    }
    const video = document.createElement("video");
    this.#video = video;
    video.hidden = true;
    video.muted = true;
    const stream = this.stream();
    video.srcObject = stream;
    // The video is inside the element, so that the element is its page's `pictureInPictureElement`.
    this.#host.shadowRoot?.append(video);
    video.addEventListener("enterpictureinpicture", () => this.#dispatch("enterpictureinpicture"));
    video.addEventListener("leavepictureinpicture", () => this.#leave());
    try {
      await video.play();
      const opened = await video.requestPictureInPicture();
      // From here on, the window's own buttons pause and play the player.
      video.addEventListener("pause", () => this.#host.pause?.());
      video.addEventListener("play", () => this.#host.play?.());
      return opened;
    } catch (error) {
      this.#stop();
      throw error;
    }
  }

  /** Stops all streams, and closes the window. */
  close() {
    this.#stop();
    for (const stream of this.#streams) stopTracks(stream);
    this.#streams.clear();
  }

  #leave() {
    this.#stop();
    this.#dispatch("leavepictureinpicture");
  }

  #stop() {
    const video = this.#video;
    if (video === null) return;
    this.#video = null;
    const stream = /** @type {MediaStream} */ (video.srcObject);
    stopTracks(stream);
    this.#streams.delete(stream);
    video.srcObject = null;
    video.remove();
  }

  /** @param {string} type */
  #dispatch(type) {
    this.#host.dispatchEvent(new Event(type));
  }
}

/** @param {MediaStream} stream */
function stopTracks(stream) {
  for (const track of stream.getTracks()) track.stop();
}
