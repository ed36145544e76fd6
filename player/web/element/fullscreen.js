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
    if (element.matches(":fullscreen")) return document.exitFullscreen().catch(() => {});
    try {
      if (element.requestFullscreen === undefined) throw new TypeError("no full screen");
      await element.requestFullscreen();
    } catch {
      this.#cover(true);
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
