/**
 * Full screen. If the browser does not support it for elements (iPhone) or refuses it, the player covers
 * the page instead.
 */
export class FullScreen {
  /**
   * @param {HTMLElement} element
   * @param {() => void} changed
   * @param {AbortSignal} signal ends the listening
   */
  constructor(element, changed, signal) {
    this.element = element;
    this.changed = changed;
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
