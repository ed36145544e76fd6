/** Other windows than the page's: the full screen, and the picture in picture. */

/**
 * Full screen. If the browser does not support it for elements (iPhone) or refuses it, the player covers
 * the page instead.
 */
export class FullScreen {
  /** @param {HTMLElement} element @param {() => void} changed @param {AbortSignal} signal ends the listening */
  constructor(element, changed, signal) {
    /** @type {HTMLElement} */ this.element = element;
    /** @type {() => void} */ this.changed = changed;
    element.addEventListener("fullscreenchange", changed, { signal });
  }

  get #covers() {
    return this.element.classList.contains("covering");
  }

  get isOn() {
    return this.#covers || this.element.matches(":fullscreen");
  }

  async toggle() {
    const { element } = this;
    if (this.#covers) return this.#cover(false);
    const isFull = element.matches(":fullscreen");
    if (!isFull && element.requestFullscreen === undefined) return this.#cover(true);
    try {
      if (isFull) await document.exitFullscreen();
      else await element.requestFullscreen();
    } catch (error) {
      console.info("swings: the browser refuses a change of full screen:", error);
      this.#cover(!isFull);
    }
  }

  /** Ends full screen if the player covers the page; real full screen is ended by the browser itself. */
  leave() {
    if (this.#covers) this.#cover(false);
  }

  /** @param {boolean} covers */
  #cover(covers) {
    this.element.classList.toggle("covering", covers);
    this.changed();
  }
}

/** The picture in a window above all others. */
export class PictureInPicture {
  #capture;
  #host;
  /** @type {HTMLVideoElement | null} plays the picture */
  #video = null;

  /**
   * @param {import("../element/pictureinterface.js").Capture} capture
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
