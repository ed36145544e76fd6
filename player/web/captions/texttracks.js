/**
 * The captions of a stream as `textTracks` of a media element, for scripts and controls made for `<video>`:
 * a script shows a track by its `mode`.
 */
export class TextTracks {
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
    this.holder = holder;
    const changed = () => {
      const modes = this.#elements.map(({ track }) => track.mode);
      const other = modes.findIndex((mode, at) => mode === "showing" && at !== this.#shown);
      if (other >= 0) choose(other);
      else if (this.#shown >= 0 && modes[this.#shown] !== "showing") choose(-1);
      for (const [at, mode] of modes.entries()) if (mode === "hidden") need(at);
    };
    holder.textTracks.addEventListener("change", changed, { signal });
  }

  /** Replaces all tracks. @param {import("./captiontracks.js").CaptionTrack[]} tracks */
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

  /** Gives a track its cues; to be called once for each. @param {number} at @param {import("./webvtt.js").Cue[]} cues */
  fill(at, cues) {
    const { track } = this.#elements[at];
    for (const { startS, endS, text } of cues) track.addCue(new VTTCue(startS, endS, text));
  }
}
