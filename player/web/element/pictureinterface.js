/** The interface of a media element beside its clock: attributes, callbacks for frames, and where else its pictures go. */

/** @typedef {import("../source/transform.js").TransformRequest} TransformRequest */

/** The attributes of media elements that are also properties, how requests are sent, and the sound's settings. */
class MediaAttributes extends HTMLElement {
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
    if (value < 0 || value > 1)
      throw new DOMException(`volume: ${value} is not in the range 0 to 1`, "IndexSizeError");
    if (value === this.#volume) return;
    this.#volume = value;
    this.queueEvent("volumechange");
  }

  /**
   * Dispatches an event once the current script has finished, as media elements do.
   * @param {string} type @param {() => void} [then] runs after the event's listeners
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

/** The canvas's picture as a video stream, for recorders and peers, and for picture in picture. */
export class Capture {
  #canvas;
  /** @type {Set<MediaStream>} streams whose tracks have not been stopped */
  #streams = new Set();

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.#canvas = canvas;
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

  /** Stops a stream. @param {MediaStream} stream */
  stop(stream) {
    for (const track of stream.getTracks()) track.stop();
    this.#streams.delete(stream);
  }

  /** Stops all streams. */
  close() {
    for (const stream of this.#streams) this.stop(stream);
  }
}

/** @typedef {import("./webplayer.js").WebPlayer} WebPlayer */

/** Scripting interface to the player's pictures: their size, frame callbacks, and capture. */
export class PictureInterface extends MediaAttributes {
  /** @type {WebPlayer | null} while the element is in a page */
  player = null;
  /** @type {Map<number, VideoFrameRequestCallback>} by handle */
  #frameCallbacks = new Map();
  #lastHandle = 0;
  #presentedFrames = 0;
  /** @type {Capture | null} */
  #capture = null;
  /** @type {import("../controls/windows.js").PictureInPicture | null} */
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
   * Calls back once, after the next frame has been drawn. https://wicg.github.io/video-rvfc/
   * @param {VideoFrameRequestCallback} callback @returns {number} a handle for `cancelVideoFrameCallback`
   */
  requestVideoFrameCallback(callback) {
    if (typeof callback !== "function") throw new TypeError("the callback is not a function");
    this.#lastHandle += 1;
    this.#frameCallbacks.set(this.#lastHandle, callback);
    return this.#lastHandle;
  }

  /** @param {number} handle */
  cancelVideoFrameCallback(handle) {
    this.#frameCallbacks.delete(handle);
  }

  /**
   * Captures the canvas, without the controls. Throws an InvalidStateError while the element is not in a page.
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
    if (this.videoWidth === 0)
      throw new DOMException("the stream is not open yet", "InvalidStateError");
    const capture = this.#capturing();
    const { PictureInPicture } = await import("../controls/windows.js");
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
    if (player?.manifest && (width !== before[0] || height !== before[1]))
      this.queueEvent("resize");
  }

  /** @protected Runs the frame callbacks; a frame is drawn in this task. @param {number} timeS of the frame */
  runFrameCallbacks(timeS) {
    const [width, height] = this.#sizePx;
    queueMicrotask(() => {
      const nowMs = performance.now();
      this.#presentedFrames += 1;
      // Pages cannot know when the screen shows a canvas; the best guess is the next refresh.
      const times = { presentationTime: nowMs, expectedDisplayTime: nowMs, mediaTime: timeS };
      const frame = { ...times, presentedFrames: this.#presentedFrames, width, height };
      for (const [handle, callback] of [...this.#frameCallbacks]) {
        if (!this.#frameCallbacks.delete(handle)) continue;
        try {
          callback(nowMs, { ...frame });
        } catch (error) {
          reportError(error);
        }
      }
    });
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
    if (player === null) throw new DOMException("the element is in no page", "InvalidStateError");
    this.#capture ??= new Capture(player.canvas);
    return this.#capture;
  }
}
