/** Time without pictures after which a frame counts as out of view; a cross-origin one has no other sign. */
const STARVED_MS = 2000;

/**
 * Whether an element certainly lies in the page's window. Observers report it only with the page's first
 * picture, which would delay the start; inside a frame, only they can know.
 * @param {Element} element
 */
function isPlainlyInView(element) {
  if (globalThis.parent !== globalThis.window) return false;
  const { top, bottom, left, right } = element.getBoundingClientRect();
  return bottom > 0 && right > 0 && top < innerHeight && left < innerWidth;
}

/** Tracks whether a picture on an element would be seen, or is needed although it is not seen. */
export class Sight {
  #isIntersecting = false;
  #isStarved = false;
  #numHolds = 0;
  #listening = new AbortController();

  /**
   * @param {Element} element
   * @param {import("./frameloop.js").FrameLoop} loop
   * @param {() => void} onChange called when isSeen has changed
   */
  constructor(element, loop, onChange) {
    this.loop = loop;
    this.onChange = onChange;
    this.#isIntersecting = isPlainlyInView(element);
    this.isSeen = this.#isIntersecting && !document.hidden;
    /** @type {import("../stereo/headset.js").Headset | null} one that shows the scene in place of the page */
    this.headset = null;
    this.observer = new IntersectionObserver((entries) => {
      this.#isIntersecting = entries[entries.length - 1].isIntersecting;
      this.update();
    });
    this.observer.observe(element);
    const { signal } = this.#listening;
    document.addEventListener("visibilitychange", () => this.update(), { signal });
  }

  /** Whether something outside of the page shows the canvas. */
  get isHeld() {
    return this.#numHolds > 0;
  }

  /**
   * Makes the element count as seen, wherever it is, until the returned function is called; used by
   * picture in picture, `captureStream` and the like.
   */
  hold() {
    let isHeld = true;
    this.#numHolds += 1;
    this.update();
    return () => {
      if (!isHeld) return;
      isHeld = false;
      this.#numHolds -= 1;
      this.update();
    };
  }

  /** To be called whenever the browser lets the player draw. */
  noteFrame() {
    if (!this.#isStarved) return;
    this.#isStarved = false;
    this.update();
  }

  /** To be called regularly during playback. */
  check() {
    if (this.#isStarved || this.loop.waitedMs < STARVED_MS) return;
    this.#isStarved = true;
    this.update();
  }

  update() {
    const isOnScreen = this.#isIntersecting && !document.hidden && !this.#isStarved;
    const isSeen = this.isHeld || (this.headset === null ? isOnScreen : !this.headset.isHidden);
    if (isSeen === this.isSeen) return;
    this.isSeen = isSeen;
    this.onChange();
  }

  dispose() {
    this.observer.disconnect();
    this.#listening.abort();
  }
}
