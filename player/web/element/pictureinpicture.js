/** The picture in a window above all others. */
export class PictureInPicture {
  #capture;
  #host;
  /** @type {HTMLVideoElement | null} plays the picture */
  #video = null;

  /**
   * @param {import("./capture.js").Capture} capture
   * @param {HTMLElement & { play?: () => Promise<void>, pause?: () => void }} host fires
   *   `enterpictureinpicture` and `leavepictureinpicture`
   */
  constructor(capture, host) {
    this.#capture = capture;
    this.#host = host;
  }

  /**
   * Opens the window. Needs a recent user gesture. Rejects like `HTMLVideoElement.requestPictureInPicture`.
   * @returns {Promise<PictureInPictureWindow>}
   */
  async open() {
    if (this.#video !== null) return this.#video.requestPictureInPicture();
    if (!document.pictureInPictureEnabled) {
      const message = "this browser has no picture in picture, or this page may not use it";
      throw new DOMException(message, "NotSupportedError");
    }
    const video = document.createElement("video");
    this.#video = video;
    video.hidden = true;
    video.muted = true;
    video.srcObject = this.#capture.stream();
    // The video is inside the element, so that the element is its page's `pictureInPictureElement`.
    this.#host.shadowRoot?.append(video);
    video.addEventListener("enterpictureinpicture", () => this.#dispatch("enterpictureinpicture"));
    video.addEventListener("leavepictureinpicture", () => {
      this.close();
      this.#dispatch("leavepictureinpicture");
    });
    try {
      await video.play();
      const opened = await video.requestPictureInPicture();
      // From here on, the window's own buttons pause and play the player.
      video.addEventListener("pause", () => this.#host.pause?.());
      video.addEventListener("play", () => this.#host.play?.());
      return opened;
    } catch (error) {
      this.close();
      throw error;
    }
  }

  /** Closes the window. */
  close() {
    const video = this.#video;
    if (video === null) return;
    this.#video = null;
    this.#capture.stop(/** @type {MediaStream} */ (video.srcObject));
    video.srcObject = null;
    video.remove();
  }

  /** @param {string} type */
  #dispatch(type) {
    this.#host.dispatchEvent(new Event(type));
  }
}
