/** Beyond this ratio of device pixels to CSS pixels, the gain is not worth the cost. */
const MOST_PIXEL_RATIO = 2;

/** Size of a canvas in device pixels: follows its layout, the browser's zoom, and the screen. */
export class CanvasSize {
  #listening = new AbortController();

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {() => void} onChange
   */
  constructor(canvas, onChange) {
    this.onChange = onChange;
    this.cssWidthPx = canvas.clientWidth;
    this.cssHeightPx = canvas.clientHeight;
    /** @type {ResizeObserverSize | null} in device pixels, where the browser knows them */
    this.devicePx = null;
    this.observer = new ResizeObserver(([entry]) => {
      const { contentRect, devicePixelContentBoxSize } = entry;
      this.cssWidthPx = contentRect.width;
      this.cssHeightPx = contentRect.height;
      this.devicePx = devicePixelContentBoxSize?.[0] ?? null;
      this.onChange();
    });
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

  /**
   * @param {number} cssPx
   * @param {number | undefined} devicePx
   */
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
