import { PLAYER_VERSION } from "../constants.js";
import { pictureUrl } from "../source/addresses.js";
import { shareAt } from "../view/orbit.js";
import { MediaInterface } from "./mediainterface.js";
import { addStyle, hasGyroscope, node, prefersStill } from "./nodes.js";
import { Hints, Overlay } from "./overlay.js";
import { NETWORK } from "./readiness.js";
import STYLE from "./style.css";
import { WebPlayer } from "./webplayer.js";

/** A part of the player that is loaded by `import()`. @template Part */
class LazyPart {
  /** @type {Part | null} null until it is loaded */
  part = null;
  /** @type {Promise<Part | null> | null} */
  #loading = null;

  /**
   * @param {() => Promise<Part | null>} load gives null if the part is not needed any more
   * @param {(error: unknown) => void} failed called if the part could not be loaded; its next use tries again
   */
  constructor(load, failed) {
    this.load = load;
    this.failed = failed;
  }

  /**
   * Runs `action` with the part as soon as it is loaded: at once if it already is, because some actions must
   * run within a user gesture.
   * @param {(part: Part) => unknown} [action]
   */
  async use(action) {
    if (this.part === null) {
      try {
        this.#loading ??= this.load();
        this.part = await this.#loading;
      } catch (error) {
        this.#loading = null;
        this.failed(error);
      }
    }
    if (this.part !== null) await action?.(this.part);
  }
}

/** @typedef {import("../format/manifest.js").Camera} Camera */
/** @typedef {import("../view/cameramotion.js").CameraMotion} CameraMotion */

const LONG_MS = 10_000;

/**
 * `<swings-player src="URL of a stream's folder or file">`: plays a stream, with controls. It has the interface of
 * media elements; docs/EMBED.md says where it differs, and what it adds.
 * @tag swings-player
 * @attr {string} src - URL of the stream's folder or file
 * @attr {boolean} autoplay - plays once it is open
 * @attr {boolean} loop - starts again at the end
 * @attr {string} start - seconds from the first frame at which it starts
 * @attr {string} view - direction of the camera at the start, as in a share link
 * @attr {"none" | "metadata" | "auto"} preload - what is fetched before it plays
 * @attr {boolean} muted - starts without sound
 * @attr {string} poster - URL of a picture to show until the first frame
 * @attr {string} max-gaussians - a stream with more is refused
 * @attr {boolean} other-hosts - allows objects on another origin than the manifest's
 * @attr {"anonymous" | "use-credentials"} crossorigin - whether requests to other hosts carry cookies
 * @attr {string} buffer-mb - most megabytes of received data that are kept
 * @attr {"false"} interpolate - each frame stands until the next one
 * @attr {"all"} gestures - one finger and the wheel always move the camera
 * @attr {string} download - URL of the stream as one file
 * @attr {string} link - URL of the page that shared links open
 * @attr {string} lang - language of the controls
 * @fires layerschange - `layers` was set
 * @fires gesturehint - a gesture was left to the page; detail: a sentence for the viewer
 * @csspart bar - the bar of controls
 * @csspart captions - the captions over the picture
 * @cssstate idle - the bar is hidden because nothing has moved for a while
 */
export class SwingsPlayerElement extends MediaInterface {
  /** Version of the player. */
  static version = PLAYER_VERSION;
  static observedAttributes = ["src", "loop", "preload", "interpolate"];

  #canvas = node("canvas", {
    tabindex: "0",
    role: "application",
    "aria-label":
      "Volumetric video. Drag to look around. Press space to play or pause, ? for all keys.",
  });
  #overlay = new Overlay(() => this.play());
  #hints = new Hints();
  /** Holds what is shown only while the player works. */
  #place = node("div", { class: "controls" });
  #frame = node(
    "div",
    { class: "frame" },
    // A headset emulator borrows the canvas, and returns it to its parent only if that is an element.
    node("div", {}, this.#canvas),
    ...this.#overlay.parts,
    this.#hints.root,
    this.#place,
  );
  /** @type {LazyPart<import("../controls/controls.js").Controls> | null} null while the element is in no page */
  #controls = null;
  /** @type {LazyPart<import("../controls/tracks.js").Tracks> | null} */
  #tracks = null;
  #textHolder = node("video");
  #internals = this.attachInternals();
  #stopListening = () => {};
  #isLooping = false;
  /** Whether there was no play or seek yet. */
  #isFresh = true;
  /** The trouble that the player has, as a sentence; "" without any. */
  #trouble = "";

  constructor() {
    super();
    const root = this.attachShadow({ mode: "open", delegatesFocus: true });
    // A page's content security policy may forbid a <style>.
    addStyle(root, STYLE);
    root.append(this.#frame);
  }

  connectedCallback() {
    const player = new WebPlayer(this.#canvas);
    this.player = player;
    const listening = new AbortController();
    this.#stopListening = () => listening.abort();
    this.#loadParts(player, listening.signal);
    this.#listen(player, listening.signal);
    this.#showMotion(player);
    this.load();
  }

  disconnectedCallback() {
    this.#stopListening();
    this.#controls = null;
    this.#tracks = null;
    this.#place.replaceChildren();
    delete this.#frame.dataset.condition;
    this.leave();
  }

  /** @param {string} name */
  attributeChangedCallback(name) {
    if (this.player === null) return;
    if (name === "src") this.load();
    else if (name === "preload") this.preloadChanged();
    else if (name === "interpolate") this.#showMotion(this.player);
    else this.#setLoop(this.loop);
  }

  /** @param {WebPlayer} player */
  #showMotion(player) {
    player.view.interpolates = this.interpolate;
  }

  /** @protected @override */
  prepare() {
    const { player } = this;
    if (player === null) return;
    player.close();
    this.#isFresh = true;
    this.#controls?.part?.clearFailure();
    this.#hints.clear();
    this.#trouble = "";
    this.#overlay.setPoster(this.getAttribute("poster"));
    this.#show(player);
  }

  /** @protected @override @param {boolean} isHeld */
  openStream(isHeld) {
    const { player } = this;
    if (player === null) return;
    const most = Number(this.getAttribute("max-gaussians"));
    const bufferMb = Number(this.getAttribute("buffer-mb"));
    player.preloads = this.getAttribute("preload") === "auto";
    player.open(this.currentSrc, {
      maxGaussians: most > 0 ? most : null,
      otherHosts: this.hasAttribute("other-hosts"),
      credentials: this.crossOrigin === "use-credentials" ? "include" : undefined,
      transformRequest: this.transformRequest ?? undefined,
      bufferMb: bufferMb > 0 ? bufferMb : null,
      isHeld,
    });
  }

  /** @param {WebPlayer} player @param {AbortSignal} signal */
  #loadParts(player, signal) {
    const [canvas, frame, place, hints] = [this.#canvas, this.#frame, this.#place, this.#hints];
    const overlay = this.#overlay;
    const changed = () => this.#show(player);
    const setIdle = (/** @type {boolean} */ isIdle) => this.#setIdle(isIdle);
    const surroundings = { player, canvas, frame, place, overlay, hints, changed, setIdle };
    const controls = new LazyPart(
      async () => {
        const { Controls, translatorOf } = await import("../controls/controls.js");
        const texts = await translatorOf(this);
        if (signal.aborted) return null;
        return new Controls({ element: this, ...surroundings }, texts, signal);
      },
      (error) => {
        console.warn(
          "swings: the controls could not be loaded; their next use tries again:",
          error,
        );
        const { message } = this.error ?? {};
        const text = "The controls could not be loaded; check the network and tap to try again";
        hints.say(message ?? text, LONG_MS);
      },
    );
    this.#controls = controls;
    this.#tracks = new LazyPart(
      async () => {
        const { Tracks, translatorOf } = await import("../controls/tracks.js");
        const { t } = await translatorOf(this);
        if (signal.aborted) return null;
        const tracks = new Tracks(this, player, place, hints, this.#textHolder, t, signal);
        controls.use((part) => tracks.addTo(part));
        return tracks;
      },
      (error) => {
        console.warn("swings: the code for sound and captions could not be loaded:", error);
        hints.say("Sound and captions could not be loaded; check the network", LONG_MS);
      },
    );
  }

  /** @param {WebPlayer} player @param {AbortSignal} signal */
  #listen(player, signal) {
    const of = (/** @type {string} */ type, /** @type {(event: Event) => void} */ action) =>
      player.addEventListener(type, action, { signal });
    of("opened", () => this.#opened(player));
    of("state", () => this.#show(player));
    of("shown", () => this.#show(player));
    of("failed", (event) => this.fail(detailOf(event)));
    of("trouble", (event) => {
      this.#trouble = detailOf(event);
      this.#show(player);
    });
    of("awaited", (event) => this.#renewPoster(detailOf(event)));
    of("select", () => this.togglePlaying());
    this.follow(player, signal);
    const on = (/** @type {string} */ type, /** @type {(event: any) => void} */ action) =>
      this.addEventListener(type, action, { signal });
    for (const type of ["play", "pause", "ended", "suspend"]) on(type, () => this.#show(player));
    on("play", () => (this.#isFresh = false));
    on("seeking", () => {
      if (player.shownFrame >= 0) this.#isFresh = false; // the seek to a link's start time does not count
    });
    on("loadedmetadata", () => (this.#isFresh = this.paused));
    // Keys that are pressed before the controls are there wait for them.
    on("keydown", (/** @type {KeyboardEvent} */ event) => {
      const [target] = event.composedPath();
      this.#controls?.use((controls) => controls.press(event, target));
    });
    on("pointerdown", () => this.#controls?.use());
  }

  /** @param {WebPlayer} player */
  #opened(player) {
    const { manifest, orbit } = player;
    if (manifest === null) return;
    if (orbit !== null) this.#overlay.setFocus(shareAt(manifest.defaultCamera, orbit.focus));
    this.#offerPoster(player);
    this.#controls?.part?.opened();
    const tracks = this.#tracks;
    if (manifest.sound || manifest.captions || tracks?.part) tracks?.use((part) => part.open());
    // With reduced motion, the viewer starts playback and every round of the loop.
    this.#setLoop(this.loop && !prefersStill());
  }

  /** Shows the stream's own poster if the page has none. @param {WebPlayer} player */
  async #offerPoster(player) {
    const poster = player.manifest?.poster;
    if (this.#overlay.hasPoster || !poster) return;
    try {
      const url = await pictureUrl(player, poster);
      if (player === this.player && !this.#overlay.hasPoster) this.#overlay.setPoster(url);
    } catch (error) {
      console.warn("swings: the poster could not be loaded:", error);
    }
  }

  /** Shows the poster of a stream without frames as it is now. @param {string | null} url */
  #renewPoster(url) {
    if (url === null || url !== this.poster) return;
    const now = new URL(url);
    now.searchParams.set("at", String(Date.now())); // past the browser's cache
    this.#overlay.setPoster(now.href);
  }

  /** @param {WebPlayer} player @returns {import("./overlay.js").Condition} */
  #conditionOf(player) {
    if (this.error !== null) return "failed";
    if (this.networkState === NETWORK.EMPTY) return "empty";
    // With `preload`, it may be that nothing is fetched before playback is started.
    if (player.shownFrame < 0) return this.networkState === NETWORK.IDLE ? "start" : "loading";
    if (player.isStill) return "still";
    if (this.ended) return "ended";
    if (this.paused) return this.#isFresh ? "start" : "paused";
    return player.state.waiting ? "waiting" : "playing";
  }

  /** @param {WebPlayer} player */
  #show(player) {
    const condition = this.#conditionOf(player);
    const controls = this.#controls?.part;
    const isWaiting = player.state.waiting && !controls?.live.hasStopped;
    this.#overlay.show(condition, player.shownFrame >= 0, isWaiting);
    // While the picture goes on, nobody needs to know.
    const isStanding = player.state.waiting || player.isSeeking || player.isDeviceLost;
    const hurts = isStanding || player.shownFrame < 0;
    this.#hints.hold("trouble", hurts ? this.#trouble : "");
    if (this.#frame.dataset.condition !== condition) {
      this.#frame.dataset.condition = condition;
      // Only now: what the first picture needs goes ahead of the controls.
      if (condition !== "loading") this.#controls?.use();
    }
    controls?.show();
  }

  /** Lets the style of a page follow the bar: `swings-player:state(idle)`. @param {boolean} isIdle */
  #setIdle(isIdle) {
    if (!CSS.supports("selector(:state(idle))")) return;
    if (isIdle) this.#internals.states.add("idle");
    else this.#internals.states.delete("idle");
  }

  /** The captions of the stream, which a script shows by their `mode`. @returns {TextTrackList} */
  get textTracks() {
    return this.#textHolder.textTracks;
  }

  togglePlaying() {
    if (this.paused) this.play();
    else this.pause();
  }

  /** Whether the stream starts again at its end. */
  get isLooping() {
    return this.#isLooping;
  }

  toggleLoop() {
    const loop = !this.#isLooping;
    this.loop = loop;
    this.#setLoop(loop);
  }

  /** Plays a live stream from its edge. */
  goLive() {
    const { player } = this;
    if (!player?.live) return;
    this.play();
    player.seekEdge();
  }

  toggleFlying() {
    this.#steer((motion) => motion.fly(!motion.isFlying));
  }

  resetView() {
    this.#steer((motion) => motion.reset());
  }

  /** Moves the camera, once the code for that is loaded. @param {(motion: CameraMotion) => void} action */
  #steer(action) {
    this.#controls?.use(({ player }) => {
      if (player.motion !== null) action(player.motion);
      player.moved();
    });
  }

  /** Names of the rig's cameras, for `flyToCamera`; none until `loadedmetadata`. @returns {string[]} */
  get cameras() {
    return this.player?.manifest?.cameras.map((/** @type {Camera} */ { name }) => name) ?? [];
  }

  /** Flies to a camera of the rig. @param {number} index into `cameras` */
  flyToCamera(index) {
    if (!Number.isInteger(index))
      throw new RangeError(`flyToCamera: ${index} is not the index of a camera`);
    this.#steer((motion) => motion.flyToCamera(index));
  }

  /** Whether this device's orientation may be able to turn the camera. */
  get hasGyroscope() {
    return hasGyroscope();
  }

  /** Whether the device's gyroscope turns the camera. */
  get isGyroscopeOn() {
    return this.#controls?.part?.camera.gyroscope.isOn ?? false;
  }

  /**
   * Switches turning the camera by the device's gyroscope on or off. Needs a recent user gesture.
   * @returns {Promise<boolean>} whether it is on
   */
  async toggleGyroscope() {
    await this.#controls?.use(({ camera }) => camera.gyroscope.toggle());
    return this.isGyroscopeOn;
  }

  toggleFullScreen() {
    this.#controls?.use(({ fullScreen }) => fullScreen.toggle());
  }

  /** Copies a link that opens the page at the current time and view. */
  async copyLink() {
    await this.#controls?.use(({ sharing }) => sharing.copyLink());
  }

  toggleStats() {
    this.#controls?.use(({ panels }) => panels.statistics.toggle());
  }

  /** Opens the stream again after a failure, at the time, rate and view it had. */
  retry() {
    const { player, paused } = this;
    if (player === null) return;
    this.reload();
    if (!paused) this.play();
    this.#canvas.focus();
  }

  /** @param {boolean} loop */
  #setLoop(loop) {
    this.#isLooping = loop;
    this.player?.setLoop(loop);
    this.#controls?.part?.bar.showToggles();
  }

  /** @protected @override @param {string} message */
  fail(message) {
    this.#hints.clear();
    this.#trouble = "";
    super.fail(message);
    this.#overlay.show("failed", this.#overlay.condition !== "loading", false);
    this.#frame.dataset.condition = "failed";
    if (this.player?.manifest) this.#offerPoster(this.player);
    this.#controls?.use((controls) => {
      if (this.error !== null) controls.fail(this.error.message);
    });
  }
}

/** @param {Event} event */
function detailOf(event) {
  return /** @type {CustomEvent<string | null>} */ (event).detail ?? "";
}

const defined = /** @type {{ version?: string } | undefined} */ (
  customElements.get("swings-player")
);
if (defined === undefined) customElements.define("swings-player", SwingsPlayerElement);
else {
  console.warn(
    `swings-player ${PLAYER_VERSION} was loaded where ${defined.version ?? "another element"} already is ` +
      "<swings-player>; the first one stays",
  );
}
