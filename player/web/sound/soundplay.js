import { MAX_SOUND_BYTES, SAMPLE_RATE } from "../constants.js";
import { servedBase } from "../source/addresses.js";
import { Fetcher } from "../source/fetcher.js";
import { fileBytes, objectPath, objectUrl } from "../source/files.js";
import { AudioClock, audioContext, decode, leaveDevice, useDevice } from "./audiodevice.js";
import { SoundRun } from "./soundrun.js";
import { FetchPace, heardAt, readSources, SoundTrack } from "./soundtrack.js";
import { Timeline } from "./timeline.js";

const STEP_MS = 100;
/** Objects are fetched this many seconds ahead, and samples decoded this many. */
const FETCHED_S = 15;
const DECODED_S = 3;
const MOST_PIECES = 300;
/** With this many bytes of sound in memory, nothing more is fetched ahead. */
const MOST_BYTES = 2 * MAX_SOUND_BYTES;
/** Maximum and minimum step in which the pictures follow the sound. */
const MOST_FOLLOWED_MS = 20;
const LEAST_FOLLOWED_MS = 2;
/** If sound and pictures differ by more than this, for example after sleep, the sound restarts. */
const APART_MS = 600;
/** A browser that does not run the device after this time waits for a user gesture. */
const BLOCKED_MS = 300;
const MOST_LATE_MS = 500;
/** The delay of pictures is the median of this many, because single pictures may be very late. */
const LATES = 31;
const TURN_S = 0.05;

/** @typedef {import("../element/webplayer.js").WebPlayer} WebPlayer */

/**
 * The sound of a player's open stream. The player's pictures determine when it begins; from then on, the
 * pictures follow the audio device's clock. A source at a place is heard through a PannerNode with its
 * defaults, softer with the distance by the law of player/sound/feed.py.
 *
 * Events: `blocked` (isBlocked), `refused` (detail: a sentence; once).
 */
export class SoundPlay extends EventTarget {
  /** Whether the browser requires a user gesture before it plays sound. */
  isBlocked = false;
  isMuted = false;
  /** Gaps of all runs before the current one. */
  #gaps = 0;
  /** @type {SoundRun | null} */
  run = null;
  /** @type {WebPlayer["line"]} the line that the run follows */
  #line = null;
  /** @type {{ track: SoundTrack, panner: PannerNode | null, output: AudioNode }[]} */
  #voices = [];
  /** @type {GainNode | null} */
  #gain = null;
  /** @type {AudioClock | null} */
  #clock = null;
  volume = 1;
  /** Delay between the time when a picture is due and when it shows. */
  #lateMs = 0;
  /** @type {number[]} */
  #lates = [];
  #waitsSinceMs = 0;
  #isRefused = false;
  #pace = new FetchPace();
  #hasEnded = false;
  #ending = new AbortController();
  #onDevice = () => this.step();

  /**
   * Throws a FormatError if the manifest's sources break a rule, and an Error without Web Audio.
   * @param {WebPlayer} player one whose open stream has sound @param {() => boolean} loops
   */
  constructor(player, loops) {
    super();
    const manifest = /** @type {import("../playback/messages.js").OpenManifest} */ (
      player.manifest
    );
    /** @type {WebPlayer} */ this.player = player;
    this.manifest = manifest;
    /** @type {() => boolean} */ this.loops = loops;
    this.sources = readSources(manifest.sound);
    if (typeof AudioContext === "undefined") throw new Error("this browser has no Web Audio");
    this.timeline = new Timeline(manifest.fps, manifest.segmentFrames);
    const { signal } = this.#ending;
    player.addEventListener("line", () => this.step(), { signal });
    player.addEventListener("shown", () => this.#shown(), { signal });
    player.addEventListener("ended", () => this.#end(), { signal });
    const timer = setInterval(() => this.step(), STEP_MS);
    signal.addEventListener("abort", () => clearInterval(timer));
  }

  /** Number of pieces that were decoded too late. */
  get gaps() {
    return this.#gaps + (this.run?.gaps ?? 0);
  }

  /** @param {number} volume 0 to 1 @param {boolean} isMuted */
  setVolume(volume, isMuted) {
    this.volume = volume;
    this.isMuted = isMuted;
    this.#gain?.gain.setTargetAtTime(volume, audioContext().currentTime, 0.01);
    this.step();
  }

  /** To be called during a user gesture, when the browser may permit sound. */
  unblock() {
    const { signal } = this.#ending;
    useDevice(this, true);
    audioContext().addEventListener("statechange", this.#onDevice, { signal }); // repeated calls add it once
  }

  /** Brings the sound up to date with the player; called regularly. */
  step() {
    if (this.#ending.signal.aborted) return;
    const { line, numFrames, live } = this.player;
    this.timeline.reach(numFrames, live);
    const isMuted = this.isMuted || this.volume === 0;
    const isDue = line?.zeroMs != null && !isMuted && this.timeline.length > 0;
    if (!isDue) {
      // At the end of the stream, the remaining sound is still played.
      const isEnding = this.#hasEnded && !isMuted && !this.player.isSeeking;
      if (!isEnding || (this.run?.aheadS ?? 0) < 0) this.#stop();
      leaveDevice(this);
      this.#block(false);
      return;
    }
    this.#hasEnded = false;
    useDevice(this);
    const context = audioContext();
    if (context.state !== "running") {
      this.#stop();
      this.#waitsSinceMs ||= performance.now();
      if (performance.now() - this.#waitsSinceMs > BLOCKED_MS) this.#block(true);
      return;
    }
    this.#waitsSinceMs = 0;
    this.#block(false);
    this.#clock ??= new AudioClock(context);
    this.#clock.look();
    if (this.run === null || this.#line !== line) this.#begin(context, line);
    this.#follow();
    this.#advance();
  }

  #end() {
    this.#hasEnded = true;
    this.run?.end();
  }

  /** Converts the worker's Unix time to milliseconds on this page's clock. @param {number} epochMs */
  #pageMs(epochMs) {
    return epochMs - performance.timeOrigin;
  }

  /** @param {AudioContext} context @param {NonNullable<WebPlayer["line"]>} line */
  #begin(context, line) {
    this.#stop();
    this.#build(context);
    this.#line = line;
    const zeroS = (this.#pageMs(line.zeroMs ?? 0) + this.#lateMs) / 1000;
    const outputs = this.#voices.map(
      ({ track, output }) => /** @type {[SoundTrack, AudioNode]} */ ([track, output]),
    );
    const atS = zeroS + (this.#clock?.offsetS ?? 0);
    this.run = new SoundRun(context, this.timeline, outputs, atS, line.rate);
  }

  /** Makes the pictures follow the sound. */
  #follow() {
    const { run, player } = this;
    const line = this.#line;
    if (run === null || line?.zeroMs == null) return;
    const heardMs = 1000 * (run.zeroS - (this.#clock?.offsetS ?? 0));
    const byMs = heardMs - this.#lateMs - this.#pageMs(line.zeroMs);
    if (Math.abs(byMs) > APART_MS) {
      this.#stop(); // the next step begins a new run
      return;
    }
    if (Math.abs(byMs) < LEAST_FOLLOWED_MS) return;
    const stepMs = Math.max(-MOST_FOLLOWED_MS, Math.min(MOST_FOLLOWED_MS, byMs));
    line.zeroMs += stepMs;
    player.workers?.post({ kind: "follow", line: line.line, byMs: stepMs });
  }

  #advance() {
    const { run, timeline, player } = this;
    if (run === null) return;
    const loops = this.loops() && !player.live;
    run.setLoops(loops, performance.now() / 1000 + (this.#clock?.offsetS ?? 0));
    const ahead = (/** @type {number} */ seconds, /** @type {number} */ most) =>
      timeline.piecesFrom(run.sample, seconds * SAMPLE_RATE * run.rate, loops, most);
    const pieces = ahead(FETCHED_S, MOST_PIECES);
    const numDecoded = ahead(DECODED_S, MOST_PIECES).length;
    const numBytes = this.#voices.reduce((sum, { track }) => sum + track.numBytes, 0);
    const { currentTime } = run.context;
    const w2c = player.sorter?.requestedW2c ?? [];
    const passed = run.sample - (pieces[0]?.begin ?? 0);
    const allows = (/** @type {number} */ numBefore) =>
      this.#pace.allows((1000 * (numBefore - passed)) / SAMPLE_RATE / run.rate, performance.now());
    for (const { track, panner } of this.#voices) {
      track.want(pieces, numDecoded, numBytes >= MOST_BYTES, allows);
      if (panner === null || w2c.length === 0) continue;
      // The listener keeps its default pose and looks along -z; the sources move around it.
      const [x, y, z] = heardAt(track.source.keys, run.sample / SAMPLE_RATE, w2c);
      panner.positionX.setTargetAtTime(x, currentTime, TURN_S);
      panner.positionY.setTargetAtTime(y, currentTime, TURN_S);
      panner.positionZ.setTargetAtTime(z, currentTime, TURN_S);
    }
    run.step();
  }

  /** @param {AudioContext} context */
  #build(context) {
    if (this.#gain !== null) return;
    const gain = context.createGain();
    gain.gain.value = this.volume;
    gain.connect(context.destination);
    this.#gain = gain;
    const { player, manifest } = this;
    const { base, source, files } = player;
    const { credentials, transformRequest } = source ?? {};
    const fetcher = new Fetcher({ credentials, transformRequest });
    const isServed = servedBase(base) !== null;
    const urlOf = (/** @type {number} */ segment, /** @type {string} */ part) =>
      isServed
        ? `${base}segments/${segment}/${part}`
        : objectUrl(base, objectPath(manifest, segment, part), source?.otherHosts ?? false);
    const fetchObject = async (
      /** @type {number} */ segment,
      /** @type {string} */ part,
      /** @type {AbortSignal} */ signal,
    ) => {
      const init = /** @type {RequestInit} */ ({ signal, priority: "high" });
      const beganMs = performance.now();
      const bytes =
        files === null
          ? await fetcher.get(urlOf(segment, part), MAX_SOUND_BYTES, undefined, init)
          : await fileBytes(
              fetcher,
              base,
              `segments/${segment}/${part}`,
              files,
              MAX_SOUND_BYTES,
              init,
            );
      const [first, end] = this.timeline.span(segment);
      const lengthMs = (1000 * (end - first)) / SAMPLE_RATE / (this.#line?.rate ?? 1);
      this.#pace.fetched(beganMs, performance.now(), lengthMs);
      return bytes;
    };
    const refused = (/** @type {unknown} */ error) => this.#refuse(error);
    this.#voices = this.sources.map((one) => {
      const track = new SoundTrack(one, this.timeline, fetchObject, decode, refused);
      const panner = one.keys.length > 0 ? context.createPanner() : null;
      panner?.connect(gain);
      return { track, panner, output: panner ?? gain };
    });
  }

  #shown() {
    const { player } = this;
    const line = player.line;
    if (line?.zeroMs == null || player.isSeeking) return;
    const { fps } = this.manifest;
    const roundMs = (1000 * player.numFrames) / fps / line.rate;
    const dueMs = this.#pageMs(line.zeroMs) + (1000 * player.shownFrame) / fps / line.rate;
    const lateMs = (performance.now() - dueMs + roundMs) % roundMs;
    if (lateMs > MOST_LATE_MS) return;
    this.#lates.push(lateMs);
    if (this.#lates.length > LATES) this.#lates.shift();
    const sorted = this.#lates.toSorted((a, b) => a - b);
    this.#lateMs = sorted[sorted.length >> 1];
  }

  #stop() {
    if (this.run === null) return;
    this.#gaps += this.run.gaps;
    this.run.stop();
    this.run = null;
    this.#line = null;
  }

  /** @param {boolean} isBlocked */
  #block(isBlocked) {
    if (!isBlocked) this.#waitsSinceMs = 0;
    if (isBlocked === this.isBlocked) return;
    this.isBlocked = isBlocked;
    this.dispatchEvent(new Event("blocked"));
  }

  /** @param {unknown} error */
  #refuse(error) {
    if (this.#isRefused) return;
    this.#isRefused = true;
    const detail = error instanceof Error ? error.message : String(error);
    this.dispatchEvent(new CustomEvent("refused", { detail }));
  }

  close() {
    this.#stop();
    this.#ending.abort();
    leaveDevice(this);
    for (const { track, panner } of this.#voices) {
      track.close();
      panner?.disconnect();
    }
    const gain = this.#gain;
    setTimeout(() => gain?.disconnect(), 1000);
  }
}
