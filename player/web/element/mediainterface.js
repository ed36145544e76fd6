/** @typedef {import("./webplayer.js").WebPlayer} WebPlayer */

/**
 * What a page's script uses of `<swings-player>`. What a media element of HTML has too bears its name
 * and means the same: https://html.spec.whatwg.org/multipage/media.html
 *
 * Events: `loadedmetadata`, `play`, `playing`, `waiting`, `pause`, `timeupdate` (another frame shows),
 * `seeking`, `seeked`, `ratechange`, `ended`, `error`, and `layerschange`.
 */
export class MediaInterface extends HTMLElement {
  /** @type {WebPlayer | null} while the element is in a page */
  player = null;
  /** @type {{ message: string } | null} why nothing plays */
  error = null;
  #paused = true;
  #ended = false;
  /** Whether the last frame is due, but may not show yet. */
  #isEnding = false;
  #rate = 1;
  #layers = 0;
  /** @type {number | null} where to begin, if a script said so before the stream was open */
  #startS = null;
  /** Whether `playing` was the last to be said of `playing`, `waiting` and `pause`. */
  #advances = false;

  /** URL of the stream's folder. */
  get src() {
    return this.getAttribute("src") ?? "";
  }

  set src(url) {
    this.setAttribute("src", url);
  }

  get poster() {
    return this.getAttribute("poster") ?? "";
  }

  set poster(url) {
    this.setAttribute("poster", url);
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

  get paused() {
    return this.#paused;
  }

  /** Whether the last frame was reached, and nothing sought since. */
  get ended() {
    return this.#ended;
  }

  get seeking() {
    return this.player?.isSeeking ?? false;
  }

  /** Seconds; NaN until `loadedmetadata`. */
  get duration() {
    const { player } = this;
    return player?.manifest ? player.numFrames / player.manifest.fps : NaN;
  }

  /** Of the frame that shows, or is sought, in seconds from the first. */
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

  get playbackRate() {
    return this.#rate;
  }

  set playbackRate(rate) {
    if (!(rate > 0 && rate < Infinity)) {
      throw new RangeError(`playbackRate: ${rate} is not a positive number`);
    }
    this.#rate = rate;
    this.player?.setRate(rate);
    this.#say("ratechange");
  }

  /** Layers that are shown at most; 0: as many as the link carries. */
  get layers() {
    return this.#layers;
  }

  set layers(most) {
    if (!(Number.isInteger(most) && most >= 0)) {
      throw new RangeError(`layers: ${most} is not a whole number of 0 or more`);
    }
    this.#layers = most;
    this.#setLayers();
    this.#say("layerschange");
  }

  /** Layers of the stream; 0 until `loadedmetadata`. */
  get numLayers() {
    return this.player?.manifest?.numLayers ?? 0;
  }

  /** Where a person or a script has turned the camera, as links hold it; "" until `loadedmetadata`. */
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

  /** Plays, from the first frame after the last one has shown; as soon as the stream is open. */
  play() {
    if (!this.#paused) return;
    this.#paused = false;
    this.#ended = false;
    this.#say("play");
    this.player?.setPlaying(true);
  }

  pause() {
    if (this.#paused) return;
    this.#paused = true;
    this.#advances = false;
    this.player?.setPlaying(false);
    this.#say("pause");
  }

  /** A stream begins to load: what was said of the one before is no longer true. */
  reset() {
    this.error = null;
    this.#paused = true;
    this.#ended = false;
    this.#isEnding = false;
    this.#advances = false;
  }

  /** Nothing plays, and why. @param {string} message */
  fail(message) {
    this.error = { message };
    this.#say("error");
  }

  /**
   * Says what happens in a player as DOM events.
   * @param {WebPlayer} player
   * @param {AbortSignal} signal ends it
   */
  follow(player, signal) {
    const on = (/** @type {string} */ type, /** @type {() => void} */ action) =>
      player.addEventListener(type, action, { signal });
    on("opened", () => this.#begin(player));
    on("state", () => this.#look(player));
    on("shown", () => {
      this.#say("timeupdate");
      this.#end(player);
    });
    on("seeking", () => {
      this.#isEnding = false;
      this.#ended = false;
      this.#say("seeking");
    });
    on("seeked", () => this.#say("seeked"));
    on("ended", () => {
      this.#isEnding = true;
      this.#end(player);
    });
  }

  /** It has ended once the last frame shows. @param {WebPlayer} player */
  #end(player) {
    if (!this.#isEnding || player.shownFrame < player.numFrames - 1) return;
    this.#isEnding = false;
    this.#ended = true;
    this.pause();
    this.#say("ended");
  }

  /** @param {WebPlayer} player */
  #begin(player) {
    if (this.#rate !== 1) player.setRate(this.#rate);
    if (this.#layers !== 0) this.#setLayers();
    const view = this.getAttribute("view");
    if (view) this.view = view;
    const start = this.getAttribute("start");
    const startS = this.#startS ?? (start === null ? null : Number(start));
    this.#startS = null;
    // A live stream begins at its edge by itself, others at 0.
    if (startS !== null && startS >= 0) this.currentTime = startS;
    this.#say("loadedmetadata");
    if (!this.#paused) player.setPlaying(true);
    else if (this.autoplay) this.play();
  }

  /** @param {WebPlayer} player */
  #look({ state, manifest }) {
    if (this.#paused || !manifest) return;
    const advances = !state.waiting;
    if (advances === this.#advances) return;
    this.#advances = advances;
    this.#say(advances ? "playing" : "waiting");
  }

  #setLayers() {
    const { player, numLayers } = this;
    if (numLayers > 0) player?.setLayers(Math.min(this.#layers || numLayers, numLayers));
  }

  /** @param {string} type */
  #say(type) {
    this.dispatchEvent(new Event(type));
  }
}
