/** Network and decoding, in a thread of their own; see WebPlayer. */

import { FormatError } from "../format/bytes/errors.js";
import { Fetcher, SourceError } from "../source/fetcher.js";
import { edgeFrame } from "../source/liveedge.js";
import { openSource } from "../source/source.js";
import { buffersOf } from "./packing.js";
import { Playback } from "./playback.js";
import { SlicePlay } from "./sliceplay.js";
import { SlotPlay } from "./slotplay.js";
import { scope } from "./workerscope.js";

const STATE_PERIOD_S = 0.1;
/** What shows within so many seconds is not asked for again when more layers are wanted. */
const SOON_S = 0.5;

/** @typedef {import("../source/source.js").SourceStream} SourceStream */

const nowS = () => performance.now() / 1000;

/** One stream, from its opening on. */
class Player {
  /**
   * @param {MessagePort} sorter
   * @param {SourceStream} stream
   * @param {Fetcher} fetcher
   */
  constructor(sorter, stream, fetcher) {
    this.sorter = sorter;
    this.stream = stream;
    this.fetcher = fetcher;
    this.loop = false;
    this.playing = false;
    /** Of the page's seeks the last one that it knows of. */
    this.seeks = 0;
    this.rate = 1;
    this.mostLayers = stream.manifest.numLayers;
    this.decodeMs = 0;
    this.toldS = 0;
    /** @type {number | undefined} */
    this.timer = undefined;
    /** @type {import("../source/source.js").SourcePlay | undefined} */
    this.source = undefined;
    /** @type {import("../source/source.js").Sink | undefined} */
    this.sink = undefined;
    /** @type {Playback | undefined} */
    this.playback = undefined;
    this.begin(stream.manifest.live ? edgeFrame(stream.manifest, stream.numFrames) : 0);
  }

  /**
   * Goes to `frame`. A live stream that plays has too little to go on with behind its edge.
   * @param {number} frame
   * @param {number} seeks how many that makes
   */
  seek(frame, seeks) {
    this.seeks = seeks;
    const { manifest, numFrames } = this.stream;
    const isBound = manifest.live && this.playing;
    const most = Math.max(edgeFrame(manifest, numFrames), this.playback?.frame ?? 0);
    this.begin(isBound ? Math.min(frame, most) : frame);
  }

  /** Takes in that a live stream has more frames, or has ended. */
  grow() {
    if (this.playback === undefined) return;
    this.playback.numFrames = this.stream.numFrames;
    this.playback.live = this.stream.manifest.live;
    this.wake();
  }

  /** Plays from `frame` on: forgets what is here. @param {number} frame */
  begin(frame) {
    const { manifest, numFrames } = this.stream;
    const first = Math.max(0, Math.min(numFrames - 1, Math.round(frame)));
    const play = manifest.layout ? new SlotPlay(manifest) : new SlicePlay(manifest);
    this.sink = /** @type {import("../source/source.js").Sink} */ (/** @type {unknown} */ (play));
    this.playback = new Playback(play, manifest.fps, numFrames, first);
    this.playback.live = manifest.live;
    this.playback.setRate(this.rate);
    this.playback.setPlaying(this.playing);
    this.fetchFrom(first, false);
  }

  /**
   * What shows from `frame` on is asked for; what is here already stays.
   * @param {number} frame
   * @param {boolean} continues whether what shows before is here
   */
  fetchFrom(frame, continues) {
    const { sink, mostLayers } = this;
    if (sink === undefined) return;
    this.source?.close();
    this.source = this.stream.play(sink, { firstFrame: frame, continues, mostLayers, nowS });
    this.source.onNews = () => this.wake();
    this.say();
    this.wake();
  }

  /**
   * Shows this many layers at most, from what is not here on; more of them a little sooner.
   * @param {number} most
   */
  setLayers(most) {
    const { playback } = this;
    if (most === this.mostLayers || playback === undefined) return;
    const isMore = most > this.mostLayers;
    this.mostLayers = most;
    const soon = playback.nextFrame + Math.round(SOON_S * playback.fps);
    const from = isMore && this.playing ? Math.min(soon, playback.endFrame) : playback.endFrame;
    if (!playback.isJoined || !this.playing) this.begin(playback.frame);
    else if (from < this.stream.numFrames) this.fetchFrom(from, true);
  }

  /** Plays, from the beginning after the end, or pauses. @param {boolean} playing */
  setPlaying(playing) {
    this.playing = playing;
    if (playing && this.playback?.hasEnded) this.begin(0);
    this.playback?.setPlaying(playing);
    this.say();
  }

  /** Looks at once at what is to be done. */
  wake() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.step(), 0);
  }

  step() {
    const { source, playback } = this;
    if (source === undefined || playback === undefined) return;
    try {
      if (source.failure !== null) throw source.failure;
      const waitS = source.step();
      const beganMs = performance.now();
      const shown = playback.tick(nowS());
      if (shown !== null) {
        this.decodeMs = performance.now() - beganMs;
        this.show(shown);
      }
      if (shown !== null || !this.playing) this.say();
      if (playback.hasEnded && this.playing) {
        if (this.loop) {
          this.begin(0);
          return;
        }
        this.playing = false;
        playback.setPlaying(false);
        scope.postMessage({ kind: "ended" });
      }
      this.tell();
      const restS = Math.min(waitS, playback.restS(nowS()) ?? 1);
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.step(), 1000 * restS);
    } catch (error) {
      this.close();
      fail(error);
    }
  }

  /** @param {import("./playback.js").Shown} shown */
  show(shown) {
    const { numGs } = this.stream.manifest;
    const message = { ...shown, numSlots: numGs, seeks: this.seeks };
    this.sorter.postMessage(message, shown.updates.flatMap(buffersOf));
  }

  /** Tells the source where playback is. */
  say() {
    const { source, playback, playing } = this;
    if (playback !== undefined)
      source?.told(playing ? playback.nextFrame : playback.frame, !playing);
  }

  /** Tells how things stand, now and then. */
  tell() {
    const { source, playback } = this;
    if (source === undefined || playback === undefined) return;
    if (nowS() - this.toldS < STATE_PERIOD_S) return;
    this.toldS = nowS();
    scope.postMessage({
      kind: "state",
      frame: playback.frame,
      endFrame: playback.endFrame,
      playing: this.playing,
      waiting: playback.waiting,
      stalls: playback.stalls,
      layers: playback.play.layers,
      rateBps: source.rateBps,
      receivedBytes: this.fetcher.receivedBytes,
      decodeMs: this.decodeMs,
    });
  }

  close() {
    clearTimeout(this.timer);
    this.source?.close();
    this.source = undefined;
  }
}

/** @type {Player | null} */
let player = null;
/** @type {MessagePort | null} */
let sorter = null;

/** @param {unknown} error */
function fail(error) {
  const isOurs = error instanceof SourceError || error instanceof FormatError;
  const message = error instanceof Error ? error.message : String(error);
  scope.postMessage({
    kind: "failed",
    message: isOurs ? message : `The player failed: ${message}`,
  });
  if (!isOurs) throw error;
}

/**
 * @param {string} base
 * @param {number | null} maxGaussians
 */
async function open(base, maxGaussians) {
  const onTrouble = (/** @type {string | null} */ message) =>
    scope.postMessage({ kind: "trouble", message });
  const fetcher = new Fetcher({ onTrouble });
  try {
    const stream = await openSource(base, fetcher, maxGaussians);
    const { manifest, numFrames } = stream;
    const opened = { manifest: plain(manifest), numFrames, base: stream.base };
    scope.postMessage({ kind: "opened", ...opened });
    if (sorter !== null) player = new Player(sorter, stream, fetcher);
    await stream.follow(() => {
      scope.postMessage({
        kind: "grown",
        numFrames: stream.numFrames,
        live: stream.manifest.live,
      });
      player?.grow();
    });
  } catch (error) {
    fail(error);
  }
}

/** A manifest as it can be posted. @param {import("../format/manifest.js").Manifest} manifest */
function plain(manifest) {
  const { layout, ...rest } = manifest;
  return { ...rest, lattices: layout?.lattices ?? [] };
}

scope.onmessage = ({ data }) => {
  switch (data.kind) {
    case "open":
      sorter = data.port;
      open(data.base, data.maxGaussians ?? null);
      return;
    case "play":
      if (player === null) return;
      player.setPlaying(data.playing);
      break;
    case "seek":
      player?.seek(data.frame, data.seeks);
      break;
    case "rate":
      if (player !== null) player.rate = data.rate;
      player?.playback?.setRate(data.rate);
      break;
    case "loop":
      if (player !== null) player.loop = data.loop;
      break;
    case "layers":
      player?.setLayers(data.most);
      break;
  }
  player?.wake();
};
