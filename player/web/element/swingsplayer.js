import { RendererError } from "../renderer/program.js";
import { MARKUP, timeText } from "./controls.js";
import { listenToGestures } from "./gestures.js";
import { ICONS } from "./icons.js";
import { followLive } from "./livebadge.js";
import { STYLE } from "./style.js";
import { WebPlayer } from "./webplayer.js";

const IDLE_MS = 2500;
const STATS_PERIOD_MS = 250;
const TURN_PX = 30;

/**
 * `<swings-player src="URL of a stream's folder">`: plays a stream, with controls.
 *
 * Attributes: `src`, `autoplay`, `loop`, `start` (seconds), `view` (as a share link has it), `poster`.
 */
export class SwingsPlayerElement extends HTMLElement {
  static observedAttributes = ["src", "loop"];

  /** @type {WebPlayer | null} */
  player = null;
  /** @type {() => void} */
  #stopListening = () => {};
  #idleTimer = 0;
  #statsTimer = 0;
  #scrubbing = false;
  #resumes = false;

  constructor() {
    super();
    const root = this.attachShadow({ mode: "open" });
    root.innerHTML = `<style>${STYLE}</style>${MARKUP}`;
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
      this.#fail(error.message);
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
  }

  /** @param {string} name */
  attributeChangedCallback(name) {
    if (this.player === null) return;
    if (name === "src") this.#open();
    else this.#setLoop(this.hasAttribute("loop"));
  }

  #open() {
    const src = this.getAttribute("src");
    const { player } = this;
    if (!src || player === null) return;
    this.#fail("");
    const poster = /** @type {HTMLImageElement} */ (this.#part(".poster"));
    const url = this.getAttribute("poster");
    poster.hidden = !url;
    if (url) poster.src = url;
    poster.classList.remove("gone");
    this.#part(".spinner").toggleAttribute("hidden", false);
    player.open(src);
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
    player.addEventListener("ended", () => this.#show(player), { signal });
    player.addEventListener("failed", (event) => this.#fail(detailOf(event)), { signal });
    player.addEventListener("trouble", (event) => this.#hint(detailOf(event), 0), { signal });
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
    on(".rate", "change", () => player.setRate(this.#chosen(".rate")));
    on(".quality", "change", () => {
      player.setLayers(this.#chosen(".quality") || player.manifest.numLayers);
    });
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
    this.addEventListener("keydown", (event) => this.#pressed(event, player), { signal });
    for (const type of ["pointermove", "pointerdown", "keydown", "focusin"]) {
      this.addEventListener(type, () => this.#awake(), { signal });
    }
  }

  /**
   * Nothing is drawn of what nobody sees, and what is not drawn would pile up: a hidden page pauses.
   * @param {WebPlayer} player
   */
  #seenOrNot(player) {
    if (document.hidden) {
      this.#resumes = player.state.playing;
      if (this.#resumes) player.setPlaying(false);
    } else if (this.#resumes) {
      this.#resumes = false;
      player.setPlaying(true);
    }
  }

  /** @param {string} selector */
  #chosen(selector) {
    return Number(/** @type {HTMLSelectElement} */ (this.#part(selector)).value);
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
      poster.src = new URL(`${this.getAttribute("src")}/${path}`, document.baseURI).href;
      poster.hidden = false;
    }
    const view = this.getAttribute("view");
    if (view && player.orbit !== null) player.orbit.text = view;
    this.#setLoop(this.hasAttribute("loop"));
    const start = this.getAttribute("start");
    // A live stream begins at its edge by itself, others at 0.
    if (start !== null && Number(start) >= 0) player.seek(Number(start) * manifest.fps);
    if (this.hasAttribute("autoplay")) player.setPlaying(true);
  }

  /** @param {WebPlayer} player */
  #show(player) {
    const { state, numFrames } = player;
    const play = this.#part(".play");
    play.innerHTML = state.playing ? ICONS.pause : ICONS.play;
    play.setAttribute("aria-label", state.playing ? "Pause" : "Play");
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
    this.player?.setPlaying(!this.player.state.playing);
  }

  /** Plays a live stream at its edge. */
  goLive() {
    const { player } = this;
    if (!player?.live) return;
    if (!player.state.playing) this.togglePlaying();
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
    const url = new URL(location.href);
    url.searchParams.set("t", (player.state.frame / player.manifest.fps).toFixed(2));
    if (player.orbit !== null) url.searchParams.set("view", player.orbit.text);
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
      state.rateBps === null ? "not known yet" : `${(state.rateBps / 1e6).toFixed(1)} Mbit/s`;
    return [
      `frame     ${state.frame} of ${player.numFrames}, ${manifest.fps} a second`,
      `pictures  ${timings.framesPerS.toFixed(0)} a second`,
      `buffer    ${buffered.toFixed(1)} s, ${state.stalls} stalls`,
      `link      ${rate}, ${(state.receivedBytes / 1e6).toFixed(1)} MB so far`,
      `Gaussians ${renderer?.numDrawn ?? 0} of ${manifest.numGs}`,
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
    const { frame } = player.state;
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
      if (this.player?.state.playing) this.classList.add("idle");
    }, IDLE_MS);
  }

  /** @param {string} message */
  #fail(message) {
    this.#part(".note").textContent = message;
    if (message) this.#part(".spinner").toggleAttribute("hidden", true);
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
