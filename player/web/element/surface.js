/** The canvas in the page: its size, when it is drawn, and whether it is in view. */

/** Beyond this ratio of device pixels to CSS pixels, the gain is not worth the cost. */
const MOST_PIXEL_RATIO = 2;

/** Size of a canvas in device pixels: follows its layout, the browser's zoom, and the screen. */
export class CanvasSize {
  #listening = new AbortController();
  /** @type {ResizeObserverSize | null} in device pixels, where the browser knows them */
  devicePx = null;
  observer = new ResizeObserver(([entry]) => {
    const { contentRect, devicePixelContentBoxSize } = entry;
    this.cssWidthPx = contentRect.width;
    this.cssHeightPx = contentRect.height;
    this.devicePx = devicePixelContentBoxSize?.[0] ?? null;
    this.onChange();
  });

  /** @param {HTMLCanvasElement} canvas @param {() => void} onChange */
  constructor(canvas, onChange) {
    /** @type {() => void} */ this.onChange = onChange;
    /** @type {number} */ this.cssWidthPx = canvas.clientWidth;
    /** @type {number} */ this.cssHeightPx = canvas.clientHeight;
    // Safari does not report device pixels.
    const hasDevicePixels = "devicePixelContentBoxSize" in ResizeObserverEntry.prototype;
    this.observer.observe(canvas, hasDevicePixels ? { box: "device-pixel-content-box" } : {});
    this.#followRatio();
  }

  /** A media query matches one resolution only, so every change needs a new query. */
  #followRatio() {
    const query = matchMedia(`(resolution: ${devicePixelRatio}dppx)`);
    const follow = () => {
      this.#followRatio();
      this.onChange();
    };
    query.addEventListener("change", follow, { once: true, signal: this.#listening.signal });
  }

  /** Pixels of a picture per CSS pixel. */
  get pixelRatio() {
    return Math.min(MOST_PIXEL_RATIO, devicePixelRatio || 1);
  }

  get widthPx() {
    return this.#pixels(this.cssWidthPx, this.devicePx?.inlineSize);
  }

  get heightPx() {
    return this.#pixels(this.cssHeightPx, this.devicePx?.blockSize);
  }

  /** @param {number} cssPx @param {number | undefined} devicePx */
  #pixels(cssPx, devicePx) {
    const soughtPx = cssPx * this.pixelRatio;
    // The browser's own rounding, unless it belongs to another ratio or exceeds the maximum ratio.
    const isOf = devicePx !== undefined && Math.abs(devicePx - soughtPx) < 1;
    return Math.max(1, isOf ? devicePx : Math.round(soughtPx));
  }

  dispose() {
    this.observer.disconnect();
    this.#listening.abort();
  }
}

/** Calls back once before the browser's next picture if requested; idle otherwise. */
export class FrameLoop {
  #id = 0;
  #requestedMs = 0;

  /** @param {(nowMs: number) => void} draw */
  constructor(draw) {
    this.draw = draw;
  }

  request() {
    if (this.#id !== 0) return;
    this.#requestedMs = performance.now();
    this.#id = requestAnimationFrame((nowMs) => {
      this.#id = 0;
      this.draw(nowMs);
    });
  }

  /** How long the browser has let a request wait, in milliseconds; 0 if there is none. */
  get waitedMs() {
    return this.#id === 0 ? 0 : performance.now() - this.#requestedMs;
  }

  /** Calls back now instead of before the next picture. */
  flush() {
    this.stop();
    this.draw(performance.now());
  }

  stop() {
    cancelAnimationFrame(this.#id);
    this.#id = 0;
  }
}

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
  /** @type {import("../stereo/headset.js").Headset | null} one that shows the scene in place of the page */
  headset = null;
  observer = new IntersectionObserver((entries) => {
    this.#isIntersecting = entries[entries.length - 1].isIntersecting;
    this.update();
  });

  /** @param {Element} element @param {FrameLoop} loop @param {() => void} onChange called when isSeen has changed */
  constructor(element, loop, onChange) {
    /** @type {FrameLoop} */ this.loop = loop;
    /** @type {() => void} */ this.onChange = onChange;
    this.#isIntersecting = isPlainlyInView(element);
    /** @type {boolean} */ this.isSeen = this.#isIntersecting && !document.hidden;
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
