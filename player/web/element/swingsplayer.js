import { RendererError } from "../renderer/program.js";
import { MARKUP, timeText } from "./controls.js";
import { listenToGestures } from "./gestures.js";
import { ICONS } from "./icons.js";
import { followLive } from "./livebadge.js";
import { MediaInterface } from "./mediainterface.js";
import { StereoControls } from "./stereocontrols.js";
import { STYLE } from "./style.js";
import { WebPlayer } from "./webplayer.js";

const IDLE_MS = 2500;
const STATS_PERIOD_MS = 250;
const TURN_PX = 30;

/**
 * `<swings-player src="URL of a stream's folder">`: plays a stream, with controls.
 *
 * Attributes: `src`, `autoplay`, `loop`, `start` (seconds), `view` (as a share link has it), `poster`,
 * `link` (the page that share links open), `max-gaussians`. docs/EMBED.md has them all, and what a script can do.
 */
export class SwingsPlayerElement extends MediaInterface {
  static observedAttributes = ["src", "loop"];

  /** @type {StereoControls | null} */
  #stereo = null;
  /** @type {() => void} */
  #stopListening = () => {};
  #idleTimer = 0;
  #statsTimer = 0;
  #scrubbing = false;
  #resumes = false;

  constructor() {
    super();
    const root = this.attachShadow({ mode: "open", delegatesFocus: true });
    // A page's content security policy may forbid a <style>.
    const sheet = new CSSStyleSheet();
    sheet.replaceSync(STYLE);
    root.adoptedStyleSheets = [sheet];
    root.innerHTML = MARKUP;
  }

  /**
   * @template {Element} T
   * @param {string} selector
   * @returns {T}
   */
  #part(selector) {
    return /** @type {T} */ (/** @type {ShadowRoot} */ (this.shadowRoot).querySelector(selector));
  }

  get #scrub() {
    return /** @type {HTMLInputElement} */ (this.#part(".scrub"));
  }

  connectedCallback() {
    const canvas = /** @type {HTMLCanvasElement} */ (this.#part("canvas"));
    try {
      this.player = new WebPlayer(canvas);
    } catch (error) {
      if (!(error instanceof RendererError)) throw error;
      this.fail(error.message);
      return;
    }
    this.#listen(this.player, canvas);
    this.#open();
  }

  disconnectedCallback() {
    clearTimeout(this.#idleTimer);
    clearInterval(this.#statsTimer);
    this.#stopListening();
    this.player?.dispose();
    this.player = null;
    this.reset();
  }

  /** @param {string} name */
  attributeChangedCallback(name) {
    if (this.player === null) return;
    if (name === "src") {
      this.reset();
      this.#open();
    } else this.#setLoop(this.hasAttribute("loop"));
  }

  #open() {
    const src = this.getAttribute("src");
    const { player } = this;
    if (!src || player === null) return;
    this.#tell("");
    const poster = /** @type {HTMLImageElement} */ (this.#part(".poster"));
    const url = this.getAttribute("poster");
    poster.hidden = !url;
    if (url) poster.src = url;
    poster.classList.remove("gone");
    this.#part(".spinner").toggleAttribute("hidden", false);
    const most = Number(this.getAttribute("max-gaussians"));
    player.open(src, most > 0 ? most : null);
  }

  /**
   * @param {WebPlayer} player
   * @param {HTMLCanvasElement} canvas
   */
  #listen(player, canvas) {
    const listening = new AbortController();
    const { signal } = listening;
    const focalPx = () => (player.camera?.fxPx ?? 500) / player.pixelRatio;
    const stopGestures = listenToGestures(
      canvas,
      () => player.orbit,
      focalPx,
      () => player.moved(),
    );
    this.#stopListening = () => {
      listening.abort();
      stopGestures();
    };
    player.addEventListener("opened", () => this.#opened(player), { signal });
    player.addEventListener("state", () => this.#show(player), { signal });
    player.addEventListener("failed", (event) => this.fail(detailOf(event)), { signal });
    player.addEventListener("trouble", (event) => this.#hint(detailOf(event), 0), { signal });
    this.follow(player, signal);
    for (const type of ["play", "pause"]) {
      this.addEventListener(type, () => this.#show(player), { signal });
    }
    this.addEventListener("ratechange", () => this.#choose(".rate", this.playbackRate), { signal });
    this.addEventListener("layerschange", () => this.#choose(".quality", this.layers), { signal });
    const on = (
      /** @type {string} */ selector,
      /** @type {string} */ type,
      /** @type {() => void} */ action,
    ) => this.#part(selector).addEventListener(type, action, { signal });
    // It may not be there yet.
    on(".poster", "error", () => this.#part(".poster").toggleAttribute("hidden", true));
    on(".play", "click", () => this.togglePlaying());
    on(".loop", "click", () => this.toggleAttribute("loop"));
    on(".reset", "click", () => this.resetView());
    on(".share", "click", () => this.copyLink());
    on(".statistics", "click", () => this.toggleStats());
    on(".full", "click", () => this.toggleFullScreen());
    on(".rate", "change", () => (this.playbackRate = this.#chosen(".rate")));
    on(".quality", "change", () => (this.layers = this.#chosen(".quality")));
    on(".scrub", "input", () => {
      this.#scrubbing = true;
      this.#showTime(player, Number(this.#scrub.value));
    });
    on(".scrub", "change", () => {
      this.#scrubbing = false;
      player.seek(Number(this.#scrub.value));
    });
    followLive(/** @type {ShadowRoot} */ (this.shadowRoot), player, signal);
    on(".badge", "click", () => this.goLive());
    document.addEventListener("visibilitychange", () => this.#seenOrNot(player), { signal });
    player.addEventListener("headset", () => this.#seenOrNot(player), { signal });
    player.addEventListener("select", () => this.togglePlaying(), { signal });
    const hint = (/** @type {string} */ message) => this.#hint(message, 10_000);
    const root = /** @type {ShadowRoot} */ (this.shadowRoot);
    this.#stereo = new StereoControls(root, player, hint, signal);
    this.addEventListener("keydown", (event) => this.#pressed(event, player), { signal });
    for (const type of ["pointermove", "pointerdown", "keydown", "focusin"]) {
      this.addEventListener(type, () => this.#awake(), { signal });
    }
  }

  /**
   * Nothing is drawn of what nobody sees, and what is not drawn would pile up: a hidden page, or one in
   * a headset that is taken off, pauses.
   * @param {WebPlayer} player
   */
  #seenOrNot(player) {
    if (player.headset?.isHidden ?? document.hidden) {
      this.#resumes ||= !this.paused;
      this.pause();
    } else if (this.#resumes) {
      this.#resumes = false;
      this.play();
    }
  }

  /** @param {string} selector */
  #chosen(selector) {
    return Number(/** @type {HTMLSelectElement} */ (this.#part(selector)).value);
  }

  /**
   * @param {string} selector
   * @param {number} value
   */
  #choose(selector, value) {
    /** @type {HTMLSelectElement} */ (this.#part(selector)).value = String(value);
  }

  /** @param {WebPlayer} player */
  #opened(player) {
    const { manifest, numFrames } = player;
    this.#scrub.max = String(numFrames - 1);
    const quality = /** @type {HTMLSelectElement} */ (this.#part(".quality"));
    quality.replaceChildren(new Option("Auto", "0"));
    for (let layers = manifest.numLayers; layers > 0; layers--) {
      quality.append(new Option(layers === 1 ? "1 layer" : `${layers} layers`, String(layers)));
    }
    const poster = /** @type {HTMLImageElement} */ (this.#part(".poster"));
    if (poster.hidden && manifest.poster) {
      const path = manifest.poster.split("/").map(encodeURIComponent).join("/");
      poster.src = new URL(path, player.base).href;
      poster.hidden = false;
    }
    this.#choose(".quality", this.layers);
    this.#setLoop(this.loop);
  }

  /** @param {WebPlayer} player */
  #show(player) {
    const { state, numFrames } = player;
    const play = this.#part(".play");
    const label = this.paused ? "Play" : "Pause";
    // What is written anew is laid out anew, ten times a second.
    if (play.getAttribute("aria-label") !== label) {
      play.innerHTML = this.paused ? ICONS.play : ICONS.pause;
      play.setAttribute("aria-label", label);
    }
    const isShown = player.shownFrame >= 0;
    this.#part(".poster").classList.toggle("gone", isShown);
    this.#part(".spinner").toggleAttribute("hidden", !state.waiting);
    if (!this.#scrubbing) {
      this.#scrub.value = String(state.frame);
      this.#showTime(player, state.frame);
    }
    const share = (/** @type {number} */ frame) => `${(100 * frame) / Math.max(1, numFrames - 1)}%`;
    const here = share(Number(this.#scrub.value));
    const buffered = share(Math.max(state.endFrame - 1, Number(this.#scrub.value)));
    this.#scrub.style.setProperty(
      "--track",
      `linear-gradient(to right, #8ab4ff ${here}, rgb(255 255 255 / 0.5) ${here} ${buffered}, ` +
        `rgb(255 255 255 / 0.2) ${buffered})`,
    );
  }

  /**
   * @param {WebPlayer} player
   * @param {number} frame
   */
  #showTime(player, frame) {
    const { fps } = player.manifest ?? { fps: 30 };
    const text = `${timeText(frame / fps)} / ${timeText(player.numFrames / fps)}`;
    this.#part(".time").textContent = text;
    this.#scrub.setAttribute("aria-valuetext", text);
  }

  togglePlaying() {
    if (this.paused) this.play();
    else this.pause();
  }

  /** Plays a live stream at its edge. */
  goLive() {
    const { player } = this;
    if (!player?.live) return;
    this.play();
    player.seekEdge();
  }

  resetView() {
    this.player?.orbit?.reset();
    this.player?.moved();
  }

  toggleFullScreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else this.requestFullscreen?.();
  }

  /** Copies a link that opens the page at this moment and view. */
  async copyLink() {
    const { player } = this;
    if (player === null || player.manifest === null) return;
    const link = this.getAttribute("link");
    const url = new URL(link ?? new URL("../watch.html", import.meta.url).href, document.baseURI);
    if (link === null) url.searchParams.set("src", new URL(this.src, document.baseURI).href);
    url.searchParams.set("t", this.currentTime.toFixed(2));
    url.searchParams.set("view", this.view);
    try {
      await navigator.clipboard.writeText(url.href);
      this.#hint("Link copied");
    } catch {
      this.#hint(url.href, 10_000);
    }
  }

  toggleStats() {
    const stats = this.#part(".stats");
    const isOn = stats.toggleAttribute("hidden") === false;
    this.#part(".statistics").setAttribute("aria-pressed", String(isOn));
    clearInterval(this.#statsTimer);
    const write = () => (stats.textContent = this.#statsText());
    if (isOn) {
      write();
      this.#statsTimer = setInterval(write, STATS_PERIOD_MS);
    }
  }

  #statsText() {
    const { player } = this;
    if (player === null || player.manifest === null) return "";
    const { state, timings, manifest, renderer } = player;
    const ms = (/** @type {number} */ value) => `${value.toFixed(1)} ms`;
    const buffered = (state.endFrame - state.frame) / manifest.fps;
    const rate =
      state.rateBps === null ? "rate not known yet" : `${(state.rateBps / 1e6).toFixed(1)} Mbit/s`;
    return [
      `frame     ${state.frame} of ${player.numFrames}, ${manifest.fps} per second`,
      `pictures  ${timings.framesPerS.toFixed(0)} per second`,
      `buffer    ${buffered.toFixed(1)} s, ${state.stalls} stalls`,
      `link      ${rate}, ${(state.receivedBytes / 1e6).toFixed(1)} MB so far`,
      `Gaussians ${renderer?.numDrawn ?? 0} of ${manifest.numGs}`,
      `layers    ${state.layers} of ${manifest.numLayers}`,
      `decode    ${ms(state.decodeMs)}`,
      `sort      ${ms(timings.sortMs)}`,
      `upload    ${ms(timings.uploadMs)}, ${((renderer?.uploadedBytes ?? 0) / 1e6).toFixed(1)} MB so far`,
      `draw      ${ms(timings.drawMs)}`,
    ].join("\n");
  }

  /** @param {boolean} loop */
  #setLoop(loop) {
    this.player?.setLoop(loop);
    this.#part(".loop").setAttribute("aria-pressed", String(loop));
  }

  /**
   * @param {KeyboardEvent} event
   * @param {WebPlayer} player
   */
  #pressed(event, player) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const target = /** @type {Element} */ (event.composedPath()[0]);
    // What has a use for a key keeps it.
    const isOnSelect = target instanceof HTMLSelectElement;
    const isOnButton = target instanceof HTMLButtonElement;
    const frame = player.isSeeking ? player.soughtFrame : Math.max(0, player.shownFrame);
    const step = event.shiftKey ? 1 : Math.round(player.manifest?.fps ?? 30);
    const turn = (/** @type {number} */ x, /** @type {number} */ y) => {
      player.orbit?.dragTurn(x, y);
      player.moved();
    };
    /** @type {Record<string, () => void>} */
    const actions = {
      k: () => this.togglePlaying(),
      l: () => this.toggleAttribute("loop"),
      r: () => this.resetView(),
      f: () => this.toggleFullScreen(),
      c: () => this.copyLink(),
      i: () => this.toggleStats(),
      b: () => this.#stereo?.toggleSideBySide(),
      v: () => this.#stereo?.toggleHeadset(),
      w: () => turn(0, TURN_PX),
      s: () => turn(0, -TURN_PX),
      a: () => turn(TURN_PX, 0),
      d: () => turn(-TURN_PX, 0),
      "+": () => this.#approach(player, 1),
      "-": () => this.#approach(player, -1),
    };
    if (!isOnButton && !isOnSelect) actions[" "] = () => this.togglePlaying();
    if (!isOnSelect && target !== this.#scrub) {
      actions.arrowleft = () => player.seek(Math.max(0, frame - step));
      actions.arrowright = () => player.seek(Math.min(player.numFrames - 1, frame + step));
      actions.home = () => player.seek(0);
      actions.end = () => (player.live ? this.goLive() : player.seek(player.numFrames - 1));
    }
    const action = actions[event.key.toLowerCase()];
    if (action === undefined) return;
    event.preventDefault();
    action();
  }

  /**
   * @param {WebPlayer} player
   * @param {number} steps
   */
  #approach(player, steps) {
    player.orbit?.approach(steps);
    player.moved();
  }

  /** Something is being done: the controls show. */
  #awake() {
    this.classList.remove("idle");
    clearTimeout(this.#idleTimer);
    this.#idleTimer = setTimeout(() => {
      if (!this.paused) this.classList.add("idle");
    }, IDLE_MS);
  }

  /** @override @param {string} message */
  fail(message) {
    this.#tell(message);
    this.#part(".spinner").toggleAttribute("hidden", true);
    super.fail(message);
  }

  /** @param {string} message */
  #tell(message) {
    this.#part(".note").textContent = message;
  }

  /**
   * @param {string} message
   * @param {number} forMs 0: until the next one
   */
  #hint(message, forMs = 2000) {
    const note = this.#part(".note.soft");
    note.textContent = message;
    if (forMs > 0) {
      setTimeout(() => {
        if (note.textContent === message) note.textContent = "";
      }, forMs);
    }
  }
}

/** @param {Event} event */
function detailOf(event) {
  return /** @type {CustomEvent<string | null>} */ (event).detail ?? "";
}

customElements.define("swings-player", SwingsPlayerElement);
