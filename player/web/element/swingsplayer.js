import { PLAYER_VERSION } from "../constants.js";
import { pictureUrl } from "../source/pictures.js";
import { Bar } from "./bar.js";
import { BarVisibility } from "./barvisibility.js";
import { CameraControls } from "./cameracontrols.js";
import { choicesOf } from "./choices.js";
import { commandsOf } from "./commands.js";
import { Failure } from "./failure.js";
import { FullScreen } from "./fullscreen.js";
import { hasGyroscope } from "./gyroscope.js";
import { Hints } from "./hints.js";
import { keysOf, listenToKeys } from "./keys.js";
import { LazyPart } from "./lazypart.js";
import { LiveBadge } from "./livebadge.js";
import { MediaInterface } from "./mediainterface.js";
import { prefersStill } from "./motion.js";
import { node } from "./nodes.js";
import { Overlay } from "./overlay.js";
import { NETWORK } from "./readiness.js";
import { Scrubber } from "./scrubber.js";
import { StereoControls } from "./stereocontrols.js";
import { STYLE } from "./style.js";
import { WebPlayer } from "./webplayer.js";

const LONG_MS = 10_000;

/**
 * `<swings-player src="URL of a stream's folder or file">`: plays a stream, with controls.
 *
 * Attributes: `src`, `autoplay`, `loop`, `preload`, `start` (seconds), `view` (as in a share link),
 * `poster`, `muted`, `interpolate`, `link` (the page that share links open), `max-gaussians`,
 * `other-hosts`, `buffer-mb`. docs/EMBED.md describes them all, and the scripting interface.
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
  #failure = new Failure(() => this.retry());
  #sharing = new LazyPart(
    async () => {
      const { Sharing } = await import("./extras.js");
      return new Sharing(this, (message, forMs) => this.#hints.say(message, forMs));
    },
    () => this.#notLoaded(),
  );
  /** Everything that is shown only while the player works. */
  #controls = node("div", { class: "controls" });
  #frame = node(
    "div",
    { class: "frame" },
    // A headset emulator borrows the canvas, and returns it to its parent only if that is an element.
    node("div", {}, this.#canvas),
    ...this.#overlay.parts,
    this.#hints.root,
    this.#controls,
    this.#failure.root,
  );
  /** @type {ReturnType<SwingsPlayerElement["build"]> | null} */
  #parts = null;
  /** @type {CameraControls | null} */
  #camera = null;
  #stopListening = () => {};
  #isLooping = false;
  /** Whether there was no play or seek yet. */
  #isFresh = true;

  constructor() {
    super();
    const root = this.attachShadow({ mode: "open", delegatesFocus: true });
    // A page's content security policy may forbid a <style>.
    const sheet = new CSSStyleSheet();
    sheet.replaceSync(STYLE);
    root.adoptedStyleSheets = [sheet];
    root.append(this.#frame);
  }

  connectedCallback() {
    this.player = new WebPlayer(this.#canvas);
    const listening = new AbortController();
    this.#listen(this.player, listening.signal);
    this.#stopListening = () => listening.abort();
    this.#showMotion(this.player);
    this.load();
  }

  disconnectedCallback() {
    this.#stopListening();
    this.#parts?.fullScreen.leave();
    this.#parts?.panels.part?.statistics.close();
    this.#parts?.scrubber.close();
    this.#parts = null;
    this.#controls.replaceChildren();
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

  /** @override */
  prepare() {
    const { player } = this;
    if (player === null) return;
    player.close();
    this.#isFresh = true;
    this.#failure.clear();
    this.#hints.clear();
    this.#overlay.setPoster(this.getAttribute("poster"));
    this.#show(player);
  }

  /** @override @param {boolean} isHeld */
  openStream(isHeld) {
    const { player } = this;
    if (player === null) return;
    const most = Number(this.getAttribute("max-gaussians"));
    const bufferMb = Number(this.getAttribute("buffer-mb"));
    player.preloads = this.getAttribute("preload") === "auto";
    player.open(this.currentSrc, {
      maxGaussians: most > 0 ? most : null,
      otherHosts: this.hasAttribute("other-hosts"),
      bufferMb: bufferMb > 0 ? bufferMb : null,
      isHeld,
    });
  }

  /**
   * Builds the controls of `player`.
   * @param {WebPlayer} player
   * @param {AbortSignal} signal ends their listening
   */
  build(player, signal) {
    const hints = this.#hints;
    const onStopped = (/** @type {boolean} */ hasStopped) => {
      const isSaid = hasStopped && this.error === null;
      hints.hold("stopped", isSaid ? "The stream has stopped; it may go on" : "");
      visibility.wake();
      this.#show(player);
    };
    const stereo = new StereoControls(player, (message) => hints.say(message, LONG_MS));
    const notLoaded = () => this.#notLoaded();
    const panels = new LazyPart(async () => {
      const { Panels } = await import("./extras.js");
      const wake = () => visibility.wake();
      const made = new Panels(player, bar.menuButton, choices, commands, actions, wake);
      if (!signal.aborted) made.addTo(this.#controls);
      return made;
    }, notLoaded);
    const tracks = new LazyPart(async () => {
      const { Tracks } = await import("./tracks.js");
      return new Tracks(this, player, this.#controls, actions, hints, panels, signal);
    }, notLoaded);
    const scrubber = new Scrubber(player, signal);
    const live = new LiveBadge(player, onStopped, signal);
    const commands = commandsOf(this, stereo, this.#sharing, panels);
    for (const command of commands) {
      const { run } = command;
      command.run = () => {
        run();
        bar.showToggles();
      };
    }
    const choices = choicesOf(this);
    const openMenu = (/** @type {number | null} */ at) =>
      panels.use(({ menu }) => (at === null ? menu.toggle() : menu.open(at)));
    const bar = new Bar(
      { scrubber, badge: live.root, openMenu },
      choices,
      commands,
      () => this.togglePlaying(),
      () => this.toggleFullScreen(),
    );
    live.root.addEventListener("click", () => this.goLive());
    const plays = () => !this.paused && !live.hasStopped;
    const isInUse = () => panels.part?.isInUse || scrubber.isScrubbing;
    const visibility = new BarVisibility(this.#frame, this.#canvas, plays, isInUse);
    const fullScreen = new FullScreen(this, () => this.#fullScreenChanged(), signal);
    const actions = keysOf(this, player, commands);
    stereo.watch((isThere) => (bar.headset.hidden = !isThere), signal);
    this.#controls.replaceChildren(bar.root);
    return { scrubber, bar, panels, tracks, visibility, fullScreen, actions, live };
  }

  /**
   * @param {WebPlayer} player
   * @param {AbortSignal} signal
   */
  #listen(player, signal) {
    const parts = this.build(player, signal);
    this.#parts = parts;
    const { bar, panels, visibility } = parts;
    const hints = this.#hints;
    const of = (/** @type {string} */ type, /** @type {(event: Event) => void} */ action) =>
      player.addEventListener(type, action, { signal });
    of("opened", () => this.#opened(player));
    of("state", () => this.#show(player));
    of("shown", () => this.#show(player));
    of("failed", (event) => this.fail(detailOf(event)));
    of("trouble", (event) => hints.hold("trouble", detailOf(event)));
    of("headset", () => bar.showToggles());
    of("select", () => this.togglePlaying());
    this.follow(player, signal);
    const on = (/** @type {string} */ type, /** @type {(event: Event) => void} */ action) =>
      this.addEventListener(type, action, { signal });
    for (const type of ["play", "pause", "ended", "suspend"]) on(type, () => this.#show(player));
    on("play", () => (this.#isFresh = false));
    on("seeking", () => {
      if (player.shownFrame >= 0) this.#isFresh = false; // the seek to a link's start time does not count
    });
    on("loadedmetadata", () => (this.#isFresh = this.paused));
    for (const type of ["ratechange", "layerschange"]) on(type, () => bar.showChoices());
    on("pointerdown", (event) => {
      this.#frame.classList.remove("tabbed");
      const menu = panels.part?.menu;
      if (!menu?.isOpen) return;
      const path = event.composedPath();
      if (!path.includes(menu.root) && !path.includes(menu.button)) menu.close(false);
    });
    // The focus ring shows after Tab, but not after any other key.
    on("keyup", (event) => {
      if (/** @type {KeyboardEvent} */ (event).key === "Tab") this.#frame.classList.add("tabbed");
    });
    on("gesturehint", (event) => hints.say(detailOf(event)));
    visibility.listen(this, () => this.toggleFullScreen(), signal);
    listenToKeys(this, parts.actions, () => parts.fullScreen.leave(), signal);
    this.#camera = new CameraControls(this, this.#canvas, player, signal);
    this.#camera.gyroscope.addEventListener("change", () => bar.showToggles(), { signal });
  }

  /** @param {WebPlayer} player */
  #opened(player) {
    const { manifest } = player;
    if (!this.#overlay.hasPoster && manifest.poster) {
      this.#showPoster(player, manifest.poster);
    }
    this.#parts?.bar.showChoices();
    const tracks = this.#parts?.tracks;
    if (manifest.sound || manifest.captions || tracks?.part) tracks?.use((part) => part.open());
    // With reduced motion, the viewer starts playback and every round of the loop.
    this.#setLoop(this.loop && !prefersStill());
  }

  /**
   * @param {WebPlayer} player
   * @param {string} path
   */
  async #showPoster(player, path) {
    const url = await pictureUrl(player.base, path, player.files).catch(() => null);
    if (url !== null && player === this.player && !this.#overlay.hasPoster)
      this.#overlay.setPoster(url);
  }

  /**
   * @param {WebPlayer} player
   * @returns {import("./overlay.js").Condition}
   */
  #conditionOf(player) {
    if (this.error !== null) return "failed";
    // With `preload`, it may be that nothing is fetched before playback is started.
    if (player.shownFrame < 0) return this.networkState === NETWORK.IDLE ? "start" : "loading";
    if (this.ended) return "ended";
    if (this.paused) return this.#isFresh ? "start" : "paused";
    return player.state.waiting ? "waiting" : "playing";
  }

  /** @param {WebPlayer} player */
  #show(player) {
    const condition = this.#conditionOf(player);
    const isWaiting = player.state.waiting && !this.#parts?.live.hasStopped;
    this.#overlay.show(condition, player.shownFrame >= 0, isWaiting);
    if (this.#frame.dataset.condition !== condition) this.#frame.dataset.condition = condition;
    this.#parts?.bar.showPlaying(!this.paused);
    this.#parts?.scrubber.show();
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

  resetView() {
    this.player?.motion?.reset();
    this.player?.moved();
  }

  /** Names of the rig's cameras, for `flyToCamera`; none until `loadedmetadata`. @returns {string[]} */
  get cameras() {
    return this.player?.motion?.cameras.map(({ name }) => name) ?? [];
  }

  /** Flies to a camera of the rig. @param {number} index into `cameras` */
  flyToCamera(index) {
    this.player?.flyToCamera(index);
  }

  /** Whether this device's orientation may be able to turn the camera. */
  get hasGyroscope() {
    return hasGyroscope();
  }

  /** Whether the device's gyroscope turns the camera. */
  get isGyroscopeOn() {
    return this.#camera?.gyroscope.isOn ?? false;
  }

  /**
   * Switches turning the camera by the device's gyroscope on or off. Needs a recent user gesture.
   * @returns {Promise<boolean>} whether it is on
   */
  async toggleGyroscope() {
    return (await this.#camera?.gyroscope.toggle()) ?? false;
  }

  toggleFullScreen() {
    this.#parts?.fullScreen.toggle();
  }

  #fullScreenChanged() {
    this.#parts?.bar.showFull(this.#parts.fullScreen.isOn);
  }

  /** Copies a link that opens the page at the current time and view. */
  copyLink() {
    return this.#sharing.use((sharing) => sharing.copyLink());
  }

  #notLoaded() {
    this.#hints.say("This could not be loaded; check the network and try again", LONG_MS);
  }

  toggleStats() {
    this.#parts?.panels.use(({ statistics }) => statistics.toggle());
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
    this.#parts?.bar.showToggles();
  }

  /** @override @param {string} message */
  fail(message) {
    this.#failure.show(message, this.player !== null);
    this.#hints.clear();
    super.fail(message);
    this.#overlay.show("failed", this.#overlay.condition !== "loading", false);
    this.#frame.dataset.condition = "failed";
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
