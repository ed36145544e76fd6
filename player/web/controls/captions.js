import { MAX_CAPTIONS_BYTES } from "../constants.js";
import { drawn, node } from "../element/nodes.js";
import { readCaptionTracks, readCues, textAt } from "../format/captions.js";
import { Fetcher } from "../source/fetcher.js";
import { fileBytes } from "../source/files.js";

/**
 * The captions of a stream as `textTracks` of a media element, for scripts and controls made for `<video>`:
 * a script shows a track by its `mode`.
 */
class TextTracks {
  /** @type {HTMLTrackElement[]} */
  #elements = [];
  /** Index of the track that shows; -1: none. */
  #shown = -1;

  /**
   * @param {HTMLVideoElement} holder whose `textTracks` they are; in no document
   * @param {(at: number) => void} choose called when a script shows another track, or none: -1
   * @param {(at: number) => void} need called when a script wants the cues of a track that does not show
   * @param {AbortSignal} signal ends the listening
   */
  constructor(holder, choose, need, signal) {
    /** @type {HTMLVideoElement} */ this.holder = holder;
    const changed = () => {
      const modes = this.#elements.map(({ track }) => track.mode);
      const other = modes.findIndex((mode, at) => mode === "showing" && at !== this.#shown);
      if (other >= 0) choose(other);
      else if (this.#shown >= 0 && modes[this.#shown] !== "showing") choose(-1);
      for (const [at, mode] of modes.entries()) if (mode === "hidden") need(at);
    };
    holder.textTracks.addEventListener("change", changed, { signal });
  }

  /** Replaces all tracks. @param {import("../format/captions.js").CaptionTrack[]} tracks */
  open(tracks) {
    this.#shown = -1;
    // Tracks of `addTextTrack` could not be removed again.
    for (const element of this.#elements) element.remove();
    this.#elements = tracks.map(({ language, label }) => {
      const element = document.createElement("track");
      Object.assign(element, { kind: "captions", srclang: language, label });
      return element;
    });
    this.holder.append(...this.#elements);
  }

  /** @param {number} at index of the track that shows from now on; -1: none */
  show(at) {
    this.#shown = at;
    for (const [n, { track }] of this.#elements.entries()) {
      if (n === at) track.mode = "showing";
      else if (track.mode === "showing") track.mode = "disabled";
    }
  }

  /** Gives a track its cues; to be called once for each. @param {number} at @param {import("../format/captions.js").Cue[]} cues */
  fill(at, cues) {
    const { track } = this.#elements[at];
    for (const { startS, endS, text } of cues) track.addCue(new VTTCue(startS, endS, text));
  }
}

const ICON =
  "M4 5h16a1 1 0 0 1 1 1v12a1 1 0 0 1-1 1H4a1 1 0 0 1-1-1V6a1 1 0 0 1 1-1zm6.5 5.5a3 3 0 1 0 0 3l-1.3-.8a1.5 1.5 0 1 1 0-1.4zm7 0a3 3 0 1 0 0 3l-1.3-.8a1.5 1.5 0 1 1 0-1.4z";

/** Captions over the picture, and their button in the bar, which cycles through the languages and off. */
export class CaptionsControls {
  /** @type {import("../format/captions.js").CaptionTrack[]} */
  #tracks = [];
  /** Index of the track that shows; -1: none. */
  #chosen = -1;
  /** @type {string | null} the language that the viewer has chosen; it also applies to later streams */
  #language = null;
  /** @type {import("../format/captions.js").Cue[]} */
  #cues = [];
  /** Counts choices: captions that were requested for an earlier choice are not shown. */
  #choices = 0;
  /** @type {Map<number, Promise<import("../format/captions.js").Cue[]>>} by track: what was fetched */
  #fetched = new Map();
  button = node("button", { class: "cc", "aria-pressed": "false", hidden: true }, drawn(ICON));
  text = node("div", { class: "captions", part: "captions" });

  /**
   * @param {import("../element/webplayer.js").WebPlayer} player
   * @param {HTMLVideoElement} holder of the text tracks that scripts see
   * @param {(message: string) => void} say @param {import("./texts.js").Translate} t
   * @param {AbortSignal} signal ends the listening
   */
  constructor(player, holder, say, t, signal) {
    this.player = player;
    this.t = t;
    this.say = say;
    this.button.addEventListener("click", () => this.next());
    player.addEventListener("shown", () => this.#show(), { signal });
    const need = (/** @type {number} */ at) =>
      this.#cuesOf(at).catch((error) => console.warn("swings: a script gets no captions:", error));
    this.textTracks = new TextTracks(holder, (at) => this.#offer(at), need, signal);
  }

  /**
   * Offers the captions of a stream that was just opened. Throws a FormatError if the manifest breaks a rule.
   * @param {unknown} captions as listed in the stream's manifest
   */
  open(captions) {
    this.#tracks = [];
    this.#fetched.clear();
    this.textTracks.open([]);
    this.#choose(-1);
    if (captions !== undefined) this.#tracks = readCaptionTracks(captions);
    this.textTracks.open(this.#tracks);
    this.#choose(this.#tracks.findIndex(({ language }) => language === this.#language));
  }

  /** The languages for the menu. @returns {import("./menu.js").Choice} */
  get choice() {
    return {
      name: "captions",
      label: this.t("Captions"),
      isThere: () => this.#tracks.length > 0,
      values: () => [
        { value: -1, label: this.t("Off") },
        ...this.#tracks.map(({ label }, value) => ({ value, label })),
      ],
      now: () => this.#chosen,
      choose: (at) => this.#offer(at),
    };
  }

  /** Switches to the next language; after the last one, to none. */
  next() {
    if (this.#tracks.length === 0) return;
    this.#offer(this.#chosen + 1 < this.#tracks.length ? this.#chosen + 1 : -1);
  }

  /** @param {number} at index of the track that a viewer has chosen; -1: none */
  #offer(at) {
    this.#language = this.#tracks[at]?.language ?? null;
    this.say(at < 0 ? this.t("Captions off") : `${this.t("Captions")}: ${this.#tracks[at].label}`);
    this.#choose(at);
  }

  /** @param {number} at */
  async #choose(at) {
    this.#chosen = at;
    this.#choices += 1;
    const choice = this.#choices;
    this.#cues = [];
    this.#show();
    const { button } = this;
    button.hidden = this.#tracks.length === 0;
    button.setAttribute("aria-pressed", String(at >= 0));
    const name = this.t("Captions");
    const label = at < 0 ? name : `${name}: ${this.#tracks[at].label}`;
    button.setAttribute("aria-label", label);
    button.title = `${label} (C)`;
    this.textTracks.show(at);
    if (at < 0) return;
    this.text.lang = this.#tracks[at].language;
    try {
      const cues = await this.#cuesOf(at);
      if (choice !== this.#choices) return;
      this.#cues = cues;
      this.#show();
    } catch (error) {
      if (choice !== this.#choices) return;
      const why = error instanceof Error ? error.message : String(error);
      this.say(this.t("The captions of this stream cannot be shown: {why}", { why }));
    }
  }

  /** The cues of a track, fetched once unless that fails. @param {number} at */
  #cuesOf(at) {
    const known = this.#fetched.get(at);
    if (known !== undefined) return known;
    const fetching = this.#fetch(at);
    this.#fetched.set(at, fetching);
    fetching.then(
      (cues) => this.#fetched.get(at) === fetching && this.textTracks.fill(at, cues),
      () => this.#fetched.get(at) === fetching && this.#fetched.delete(at), // who asked reports it
    );
    return fetching;
  }

  /** @param {number} at */
  async #fetch(at) {
    const { base, files, source } = this.player;
    const { file } = this.#tracks[at];
    const { credentials, transformRequest } = source ?? {};
    const fetcher = new Fetcher({ credentials, transformRequest });
    const bytes = await fileBytes(fetcher, base, file, files, MAX_CAPTIONS_BYTES);
    const cues = readCues(new TextDecoder().decode(bytes));
    if (cues === null) throw new Error(`${file} is not WebVTT`);
    return cues;
  }

  #show() {
    const { shownFrame, manifest } = this.player;
    const text =
      manifest === null ? "" : textAt(this.#cues, Math.max(0, shownFrame) / manifest.fps);
    if (this.text.textContent !== text) this.text.textContent = text;
  }
}
