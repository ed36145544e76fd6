import { prefersStill } from "./nodes.js";
import { PictureInterface } from "./pictureinterface.js";
import { FrameRanges, NETWORK, Readiness, READY, SecondRanges } from "./readiness.js";

/** @typedef {import("./webplayer.js").WebPlayer} WebPlayer */

/** `code` of a MediaError. */
const ERROR = { DECODE: 3, SRC_NOT_SUPPORTED: 4 };

/**
 * The scripting interface of `<swings-player>`. Properties, methods and events that HTML media elements
 * also have keep their names and meaning: https://html.spec.whatwg.org/multipage/media.html.
 * docs/EMBED.md has the tables. The event `layerschange` is specific to this element.
 */
export class MediaInterface extends PictureInterface {
  /** @type {{ code: number, message: string } | null} the reason why playback failed */
  error = null;
  #currentSrc = "";
  #readiness = new Readiness();
  #paused = true;
  #ended = false;
  /** Whether the last frame is due, but may not show yet. */
  #isEnding = false;
  /** @type {PromiseWithResolvers<void> | null} for calls of `play` that wait for playback to begin */
  #pending = null;
  #rate = 1;
  #defaultRate = 1;
  #layers = 0;
  /** @type {number | null} start time in seconds, if a script set one before the stream was open */
  #startS = null;
  /**
   * State of a stream that may be opened again; timeS is null for a live stream.
   * @type {{ src: string, timeS: number | null, rate: number, view: string } | null}
   */
  #left = null;
  #isOpening = false;
  #played = new FrameRanges();
  /** @type {number | null} the frame shown last; null if the next frame does not continue from it */
  #playedFrame = null;

  /** Absolute URL of the stream that is loaded, or that failed to load. */
  get currentSrc() {
    return this.#currentSrc;
  }

  get readyState() {
    return this.#readiness.ready;
  }

  get networkState() {
    return this.#readiness.network;
  }

  get paused() {
    return this.#paused;
  }

  /** Whether the last frame was reached, with no seek since. */
  get ended() {
    return this.#ended;
  }

  get seeking() {
    return this.player?.isSeeking ?? false;
  }

  /** Seconds; NaN until `loadedmetadata`. For a live stream, its length so far. */
  get duration() {
    const { player } = this;
    return player?.manifest ? player.numFrames / player.manifest.fps : NaN;
  }

  /** Time of the frame that shows, or is being sought, in seconds from the first frame. */
  get currentTime() {
    const { player } = this;
    if (!player?.manifest) return this.#startS ?? 0;
    if (this.#ended) return this.duration;
    const frame = player.isSeeking ? player.soughtFrame : player.shownFrame;
    return Math.max(0, frame) / player.manifest.fps;
  }

  set currentTime(seconds) {
    const { player } = this;
    if (!Number.isFinite(seconds)) throw new TypeError(`currentTime: ${seconds} is not a time`);
    if (player?.manifest) player.seek(Math.round(seconds * player.manifest.fps));
    else this.#startS = seconds;
  }

  /** Seeks; every seek is exact here. @param {number} seconds */
  fastSeek(seconds) {
    this.currentTime = seconds;
  }

  /** Time ranges that can be shown without waiting, in seconds. */
  get buffered() {
    const { player } = this;
    if (!player?.manifest) return new SecondRanges([]);
    const frames = new FrameRanges();
    const { bufferedRanges } = player.state;
    for (const [first, end] of bufferedRanges) frames.add(first, end);
    return frames.inSeconds(player.manifest.fps);
  }

  /** The whole stream, once its duration is known. */
  get seekable() {
    const { duration } = this;
    return new SecondRanges(duration > 0 ? [[0, duration]] : []);
  }

  /** Time ranges that have been played since the stream was opened, in seconds. */
  get played() {
    return this.#played.inSeconds(this.player?.manifest?.fps ?? 1);
  }

  /** "live" while the stream grows, "on-demand", or "unknown" until `loadedmetadata`. */
  get streamType() {
    if (!this.player?.manifest) return "unknown";
    return this.player.live ? "live" : "on-demand";
  }

  get playbackRate() {
    return this.#rate;
  }

  set playbackRate(rate) {
    checkRate("playbackRate", rate);
    this.#rate = rate;
    this.player?.setRate(rate);
    this.queueEvent("ratechange");
  }

  /** The `playbackRate` that every later load starts with. */
  get defaultPlaybackRate() {
    return this.#defaultRate;
  }

  set defaultPlaybackRate(rate) {
    checkRate("defaultPlaybackRate", rate);
    this.#defaultRate = rate;
    this.queueEvent("ratechange");
  }

  /** Maximum number of layers to show; 0: as many as the link carries. */
  get layers() {
    return this.#layers;
  }

  set layers(most) {
    if (!(Number.isInteger(most) && most >= 0))
      throw new RangeError(`layers: ${most} is not a whole number of 0 or more`);
    this.#layers = most;
    this.#setLayers();
    this.queueEvent("layerschange");
  }

  /** Number of layers of the stream; 0 until `loadedmetadata`. */
  get numLayers() {
    return this.player?.manifest?.numLayers ?? 0;
  }

  /** The current view as text, in the form used in share links; "" until `loadedmetadata`. */
  get view() {
    return this.player?.orbit?.text ?? "";
  }

  set view(text) {
    const { player } = this;
    if (!player?.orbit) {
      this.setAttribute("view", text);
      return;
    }
    player.orbit.text = text;
    player.moved();
  }

  /**
   * Starts playback as soon as the stream is open; after the end, from the first frame.
   * @returns {Promise<void>} resolves when playing begins. Rejects with an AbortError if `pause`, `load`
   *   or the end comes first, and with a NotSupportedError if the stream cannot be played. Scripts may
   *   ignore it: it is never reported as unhandled.
   */
  play() {
    const { player, error } = this;
    if (error?.code === ERROR.SRC_NOT_SUPPORTED) {
      const refused = Promise.reject(new DOMException(error.message, "NotSupportedError"));
      refused.catch(() => {}); // scripts may ignore it
      return refused;
    }
    this.#pending ??= Promise.withResolvers();
    const { promise } = this.#pending;
    promise.catch(() => {}); // scripts may ignore it
    if (this.#ended) player?.seek(0);
    const isReady = this.readyState >= READY.FUTURE;
    if (this.#paused) {
      this.#paused = false;
      this.#ended = false;
      this.queueEvent("play");
      this.queueEvent(isReady ? "playing" : "waiting");
      if (player?.manifest) player.setPlaying(true);
      else if (this.networkState === NETWORK.IDLE) this.#open();
    }
    if (isReady) this.#resolvePlay();
    return promise;
  }

  pause() {
    if (this.#paused) return;
    this.#paused = true;
    this.player?.setPlaying(false);
    this.queueEvent("timeupdate");
    this.queueEvent("pause");
    this.#rejectPlay("AbortError", "play() was interrupted by a pause");
  }

  /** Loads the stream of `src` again, from its beginning. */
  load() {
    const { muted } = this;
    this.muted = muted; // from now on the attribute has no effect, as in HTML
    this.#unload();
    if (this.player === null) return;
    this.error = null;
    this.#currentSrc = this.src;
    const hasSource = this.#currentSrc !== "";
    if (hasSource) this.#fire(this.#readiness.select());
    const isWanted = this.#playsAlone || !this.#paused;
    this.prepare();
    if (!hasSource) return;
    if (this.preload === "none" && !isWanted) this.#fire(this.#readiness.suspend());
    else this.#open();
  }

  /** @protected Loads the same stream again, and continues at the same time, rate and view. */
  reload() {
    this.#keepPlace();
    this.load();
  }

  #keepPlace() {
    const { player, currentTime, view } = this;
    if (!player?.manifest) return;
    const timeS = player.live ? null : currentTime;
    this.#left = { src: this.#currentSrc, timeS, rate: this.#rate, view };
  }

  /** @protected Called before a stream is opened, now or at `play()`: the element shows its poster. */
  prepare() {}

  /**
   * Opens the stream of `src`.
   * @param {boolean} isHeld whether to fetch only the stream's description until `play()` or a seek
   * @protected
   */
  openStream(isHeld) {
    void isHeld;
  }

  /** @protected Called when the element is removed from its page: disposes of the player, but keeps the place. */
  leave() {
    const { player } = this;
    this.#keepPlace();
    this.endCapture();
    player?.dispose();
    this.player = null;
    this.#unload();
  }

  /** @protected Called when `preload` has changed: opens a stream that was waiting for it. */
  preloadChanged() {
    const waits = this.networkState === NETWORK.IDLE && !this.#isOpening;
    if (waits && this.preload !== "none") this.#open();
  }

  /** @protected Reports that the stream cannot be played. @param {string} message */
  fail(message) {
    const isOpen = this.readyState > READY.NOTHING;
    this.error = { code: isOpen ? ERROR.DECODE : ERROR.SRC_NOT_SUPPORTED, message };
    this.#readiness.network = isOpen ? NETWORK.IDLE : NETWORK.NO_SOURCE;
    this.queueEvent("error");
    this.#rejectPlay("NotSupportedError", message);
  }

  /**
   * Dispatches the events of a player as DOM events.
   * @param {WebPlayer} player @param {AbortSignal} signal ends the listening
   * @protected
   */
  follow(player, signal) {
    const on = (/** @type {string} */ type, /** @type {() => void} */ action) =>
      player.addEventListener(type, action, { signal });
    on("opened", () => this.#begin(player));
    on("state", () => this.#update(player));
    on("grown", () => this.queueEvent("durationchange"));
    on("shown", () => this.#showFrame(player));
    on("seeking", () => {
      this.#isEnding = false;
      this.#ended = false;
      this.#playedFrame = null;
      this.queueEvent("seeking");
      this.#update(player);
    });
    on("seeked", () => {
      this.#playedFrame = player.shownFrame;
      this.queueEvent("seeked");
    });
    on("ended", () => {
      this.#isEnding = true;
      this.#end(player);
    });
  }

  /** Resets all state of the stream that was loaded, if any. */
  #unload() {
    const { network } = this.#readiness;
    if (network === NETWORK.EMPTY) return;
    if (network !== NETWORK.NO_SOURCE) this.queueEvent("abort");
    this.queueEvent("emptied");
    this.#readiness.reset();
    this.#isOpening = false;
    this.#paused = true;
    this.#ended = false;
    this.#isEnding = false;
    this.#played = new FrameRanges();
    this.#playedFrame = null;
    if (this.#rate !== this.#defaultRate) this.playbackRate = this.#defaultRate;
    this.#rejectPlay("AbortError", "play() was interrupted by another load");
  }

  #open() {
    this.#isOpening = true;
    this.#readiness.network = NETWORK.LOADING;
    this.openStream(this.preload === "metadata" && this.#paused && !this.#playsAlone);
  }

  /** Whether playback starts by itself; never if the user prefers reduced motion. */
  get #playsAlone() {
    return this.autoplay && !prefersStill();
  }

  /** Ends playback once the last frame shows. @param {WebPlayer} player */
  #end(player) {
    if (!this.#isEnding || player.shownFrame < player.numFrames - 1) return;
    this.#isEnding = false;
    this.#ended = true;
    this.pause();
    this.queueEvent("ended");
  }

  /** @param {WebPlayer} player */
  #begin(player) {
    const left = this.#left?.src === this.#currentSrc ? this.#left : null;
    this.#left = null;
    if (left !== null && left.rate !== this.#rate) this.playbackRate = left.rate;
    else if (this.#rate !== 1) player.setRate(this.#rate);
    if (this.#layers !== 0) this.#setLayers();
    const view = left?.view || this.getAttribute("view");
    if (view) this.view = view;
    this.queueEvent("durationchange");
    this.measure();
    this.#fire(this.#readiness.open(performance.now() / 1000));
    const isWanted = !this.#paused || this.autoplay;
    if (this.preload === "metadata" && !isWanted) this.#fire(this.#readiness.suspend());
    const start = this.getAttribute("start");
    const startS = this.#startS ?? left?.timeS ?? (start === null ? null : Number(start));
    this.#startS = null;
    // Without a start time, a live stream begins at its edge and any other stream at 0.
    if (startS !== null && startS >= 0) this.currentTime = startS;
    if (!this.#paused) player.setPlaying(true);
    else if (this.#playsAlone) this.play();
  }

  /** @param {WebPlayer} player */
  #showFrame(player) {
    const { shownFrame, manifest } = player;
    this.queueEvent("timeupdate");
    if (this.#paused) this.#playedFrame = shownFrame;
    else if (!player.isSeeking) this.#notePlayed(shownFrame);
    this.#update(player);
    if (manifest !== null) this.runFrameCallbacks(shownFrame / manifest.fps);
    this.#end(player);
  }

  /** Records that a frame was played. @param {number} frame */
  #notePlayed(frame) {
    const before = this.#playedFrame ?? frame;
    if (frame < before) {
      // The stream has looped, which scripts see as a seek.
      this.queueEvent("seeking");
      this.queueEvent("seeked");
    }
    this.#played.add(frame < before ? frame : before, frame + 1);
    this.#playedFrame = frame;
  }

  /** @param {WebPlayer} player */
  #update(player) {
    const { state, manifest, numFrames, live } = player;
    if (!manifest) return;
    this.keepDrawing();
    this.measure();
    const { frame, endFrame, waiting, receivedBytes } = state;
    const { fps } = manifest;
    const isShown = player.shownFrame >= 0;
    const shown = { isShown, isSeeking: player.isSeeking, playing: !this.#paused };
    const loaded = { fps, frame, endFrame, numFrames, live, waiting, receivedBytes };
    this.#fire(this.#readiness.update({ ...loaded, ...shown }, performance.now() / 1000));
  }

  /** Queues events in order; `playing` also resolves pending calls of `play`. @param {string[]} types */
  #fire(types) {
    for (const type of types) {
      this.queueEvent(type);
      if (type === "playing") this.#resolvePlay();
    }
  }

  #resolvePlay() {
    const pending = this.#pending;
    this.#pending = null;
    queueMicrotask(() => pending?.resolve());
  }

  /** @param {string} name of the DOMException @param {string} message */
  #rejectPlay(name, message) {
    const pending = this.#pending;
    this.#pending = null;
    queueMicrotask(() => pending?.reject(new DOMException(message, name)));
  }

  #setLayers() {
    const { player, numLayers } = this;
    if (numLayers > 0) player?.setLayers(Math.min(this.#layers || numLayers, numLayers));
  }
}

/** @param {string} name @param {number} rate */
function checkRate(name, rate) {
  if (!(rate > 0 && rate < Infinity))
    throw new RangeError(`${name}: ${rate} is not a positive number`);
}
