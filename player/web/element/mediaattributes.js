/** @typedef {import("../source/transform.js").TransformRequest} TransformRequest */

/** The attributes of media elements that are also properties, how requests are sent, and the sound's settings. */
export class MediaAttributes extends HTMLElement {
  #volume = 1;
  /** @type {boolean | null} null: use the attribute */
  #muted = null;
  /** @type {TransformRequest | null} */
  #transformRequest = null;

  /** URL of the stream's folder; absolute when read. */
  get src() {
    return this.#url("src");
  }

  set src(url) {
    this.setAttribute("src", url);
  }

  /** URL of a picture; absolute when read. */
  get poster() {
    return this.#url("poster");
  }

  set poster(url) {
    this.setAttribute("poster", url);
  }

  /**
   * Whether requests to other hosts carry cookies; null without the attribute.
   * @returns {"anonymous" | "use-credentials" | null}
   */
  get crossOrigin() {
    const value = this.getAttribute("crossorigin");
    if (value === null) return null;
    return value.toLowerCase() === "use-credentials" ? "use-credentials" : "anonymous";
  }

  set crossOrigin(value) {
    if (value === null) this.removeAttribute("crossorigin");
    else this.setAttribute("crossorigin", value);
  }

  /**
   * May change the URL, the headers and the credentials of each request for the stream; read when a stream is opened.
   * @returns {TransformRequest | null}
   */
  get transformRequest() {
    return this.#transformRequest;
  }

  set transformRequest(action) {
    if (action !== null && typeof action !== "function")
      throw new TypeError(`transformRequest: ${action} is not a function`);
    this.#transformRequest = action;
  }

  get autoplay() {
    return this.hasAttribute("autoplay");
  }

  set autoplay(value) {
    this.toggleAttribute("autoplay", value);
  }

  get loop() {
    return this.hasAttribute("loop");
  }

  set loop(value) {
    this.toggleAttribute("loop", value);
  }

  /** Whether pictures between two frames show motion, if the screen is faster than the stream. */
  get interpolate() {
    return this.getAttribute("interpolate") !== "false";
  }

  set interpolate(value) {
    this.setAttribute("interpolate", String(Boolean(value)));
  }

  /**
   * Amount fetched before `play()`: nothing, the stream's description, or also the first seconds.
   * @returns {"none" | "metadata" | "auto"}
   */
  get preload() {
    const value = this.getAttribute("preload")?.toLowerCase();
    return value === "none" || value === "metadata" ? value : "auto";
  }

  set preload(value) {
    this.setAttribute("preload", value);
  }

  get defaultMuted() {
    return this.hasAttribute("muted");
  }

  set defaultMuted(value) {
    this.toggleAttribute("muted", value);
  }

  get muted() {
    return this.#muted ?? this.defaultMuted;
  }

  set muted(value) {
    const before = this.muted;
    this.#muted = Boolean(value);
    if (this.#muted !== before) this.queueEvent("volumechange");
  }

  /** 0 to 1. */
  get volume() {
    return this.#volume;
  }

  set volume(value) {
    if (!Number.isFinite(value)) throw new TypeError(`volume: ${value} is not a number`);
    if (value < 0 || value > 1) {
      throw new DOMException(`volume: ${value} is not in the range 0 to 1`, "IndexSizeError");
    }
    if (value === this.#volume) return;
    this.#volume = value;
    this.queueEvent("volumechange");
  }

  /**
   * Dispatches an event once the current script has finished, as media elements do.
   * @param {string} type
   * @param {() => void} [then] runs after the event's listeners
   * @protected
   */
  queueEvent(type, then) {
    queueMicrotask(() => {
      this.dispatchEvent(new Event(type));
      then?.();
    });
  }

  /** @param {string} name */
  #url(name) {
    const value = this.getAttribute(name);
    if (!value) return "";
    return URL.parse(value, document.baseURI)?.href ?? value;
  }
}
