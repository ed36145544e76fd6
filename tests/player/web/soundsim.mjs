/**
 * Ten minutes of a clip with clicks in virtual time: the real player of a worker and the real sound of a
 * page, on clocks that run apart, with a device that plays what it is given. Prints when each click is
 * heard and each frame shows, in milliseconds of the page's clock. What happens meanwhile is chosen:
 * `seeks` (and stalls, in a loop), `live` (half of the time it grows, then it loops) or `once` (the loop is
 * switched off just before the end of its second round).
 */
import { ChunkFeed } from "../../../player/web/playback/chunkfeed.js";
import { StreamPlay } from "../../../player/web/playback/streamplay.js";
import { StreamPlayer } from "../../../player/web/playback/streamplayer.js";
import { SlotLayout } from "../../../player/web/format/slots/slotlayout.js";
import { SoundPlay } from "../../../player/web/sound/soundplay.js";
import { SoundTrack } from "../../../player/web/sound/soundtrack.js";

const [fps, numFrames, clickFrames, lastsS, seed] = process.argv.slice(2).map(Number);
const what = process.argv[7];
const isLive = what === "live";
/** The device's clock runs faster than the page's. */
const FASTER = 1 + 2e-4;
const LATENCY_S = 0.06;

let state = seed;
/** From 0 to 1, the same each time. */
function random() {
  state = (1664525 * state + 1013904223) % 2 ** 32;
  return state / 2 ** 32;
}

// Time: timers run one after another, each with what was posted meanwhile.
let nowMs = 1000;
/** @type {{ atMs: number, id: number, run: () => void, everyMs: number | null }[]} */
let timers = [];
let ids = 0;
/** @param {() => void} run @param {number} ms @param {number | null} everyMs */
function add(run, ms, everyMs = null) {
  timers.push({ atMs: nowMs + Math.max(0.01, ms || 0), id: ++ids, run, everyMs });
  return ids;
}
/** @param {number} id */
const clear = (id) => (timers = timers.filter((timer) => timer.id !== id));
Object.assign(globalThis, {
  setTimeout: add,
  setInterval: (/** @type {() => void} */ run, /** @type {number} */ ms) => add(run, ms, ms),
  clearTimeout: clear,
  clearInterval: clear,
});
performance.now = () => nowMs;

/** @type {{ atS: number, node: any }[]} */
const started = [];
const deviceS = () => (nowMs / 1000) * FASTER;
const param = () => ({ setValueAtTime() {}, setTargetAtTime() {}, cancelScheduledValues() {} });
class FakeContext extends EventTarget {
  state = "running";
  baseLatency = 0.01;
  destination = {};
  get currentTime() {
    return Math.floor(deviceS() * 375) / 375; // in blocks of 128 samples
  }
  getOutputTimestamp() {
    return {
      contextTime: deviceS() - LATENCY_S + 0.004 * (random() - 0.5),
      performanceTime: nowMs,
    };
  }
  createGain() {
    return { gain: param(), connect() {}, disconnect() {} };
  }
  /** @param {number} numChannels @param {number} length */
  createBuffer(numChannels, length) {
    const data = Array.from({ length: numChannels }, () => new Float32Array(length));
    return {
      data,
      copyToChannel: (/** @type {Float32Array} */ from, /** @type {number} */ n) =>
        data[n].set(from),
    };
  }
  createBufferSource() {
    const node = {
      buffer: /** @type {any} */ (null),
      stopS: Infinity,
      connect() {},
      disconnect() {},
      start: (/** @type {number} */ atS) => started.push({ atS, node }),
      stop: (/** @type {number} */ atS) => (node.stopS = atS),
    };
    return node;
  }
  async resume() {}
  async suspend() {}
}
Object.assign(globalThis, { AudioContext: FakeContext });

// The stream: every frame is there, but for a stall; every piece has its clicks.
let isStalled = false;
const there = () => !isStalled;
Object.assign(StreamPlay.prototype, {
  has: there,
  canAdvance: there,
  join: () => [],
  again: () => [],
  advance: () => ({ isJoin: false, updates: [] }),
});
ChunkFeed.prototype.advance = () => {};
const layout = new SlotLayout(1, 15, 0, [1], [/** @type {any} */ ({})]);
const manifest = {
  fps,
  numFrames,
  segmentFrames: 15,
  numGs: 1,
  numLayers: 1,
  shDegree: 0,
  live: isLive,
  layout,
  parts: [],
};
const cache = {
  setPlayhead() {},
  segmentOf: () => 0,
  listeners: new Set(),
  ranges: () => [],
  endOf: () => 0,
  snapshot: () => null,
  onData() {},
};
const source = () => ({
  step: () => 1,
  reportPosition() {},
  moveTo: () => false,
  close() {},
  rateBps: null,
  failure: null,
  isDone: true,
});
/** Whether anything was wanted of a live stream that was heard already. */
let isOldWanted = false;
SoundTrack.prototype.want = (pieces) => {
  const shownS = page.shownFrame / fps;
  if (page.live && pieces.some(({ end }) => end / 48000 < shownS - 0.1)) isOldWanted = true;
};
const clickAt = (/** @type {number} */ frame) => Math.floor((frame * 48000) / fps);
SoundTrack.prototype.samples = function (begin) {
  const { end } = sound.timeline.pieceAt(begin);
  const made = new Float32Array(end - begin);
  for (let frame = 0; frame < page.numFrames; frame += clickFrames) {
    const at = clickAt(frame) - begin;
    if (at >= 0 && at < made.length) made[at] = 1;
  }
  return [made];
};

/** @type {{ frame: number, atMs: number }[]} */
const shown = [];
const page = Object.assign(new EventTarget(), {
  manifest: { ...manifest, sound: [{ name: "main", channels: 1, keys: [] }] },
  base: "http://x/",
  source: null,
  numFrames,
  live: isLive,
  line: /** @type {any} */ (null),
  shownFrame: -1,
  isSeeking: false,
  wantsPlaying: true,
  workers: {
    requestedW2c: [],
    post: (/** @type {any} */ data) => add(() => player.follow(data), 1),
  },
});
const outlet = {
  post: (/** @type {any} */ message) => {
    if (message.kind === "ended") add(() => page.dispatchEvent(new Event("ended")), 1);
    if (message.kind !== "line") return;
    add(() => {
      page.line = message;
      page.dispatchEvent(new Event("line"));
    }, 1);
  },
  // A picture is sorted, and waits for the next one of the browser.
  show: (/** @type {any} */ one) => {
    const readyMs = nowMs + 2 + 6 * random();
    const frameMs = 1000 / 60;
    add(
      () => {
        page.shownFrame = one.frame;
        if (one.seeks === seeks) page.isSeeking = false;
        shown.push({ frame: one.frame, atMs: nowMs });
        page.dispatchEvent(new Event("shown"));
      },
      Math.ceil(readyMs / frameMs) * frameMs - nowMs,
    );
  },
  fail: (/** @type {unknown} */ error) => {
    throw error;
  },
};
let seeks = 0;
const stream = { manifest, numFrames, cache, base: "", files: null, play: source };
const player = new StreamPlayer(/** @type {any} */ (stream), /** @type {any} */ ({}), outlet, {
  loop: true,
});
const sound = new SoundPlay(/** @type {any} */ (page), () => player.loop);
player.setPlaying(true);
player.wake();

/** @param {number} frames that have come @param {boolean} live */
function grow(frames, live) {
  stream.numFrames += frames;
  page.numFrames = stream.numFrames;
  page.live = manifest.live = live;
  player.grow();
  page.dispatchEvent(new Event("grown"));
}
if (isLive) {
  const segmentMs = (1000 * manifest.segmentFrames) / fps;
  for (let ms = segmentMs; ms < 500 * lastsS; ms += segmentMs)
    add(() => grow(manifest.segmentFrames, true), ms);
  add(() => grow(7, false), 500 * lastsS);
}
if (what === "once") add(() => (player.loop = false), (2000 * numFrames) / fps - 400);

// What a viewer and a link do: 20 seeks, 3 stalls; the loops come by themselves.
/** @type {number[]} when something was disturbed */
const disturbed = [];
for (let n = 0; what === "seeks" && n < 20; n++) {
  add(
    () => {
      disturbed.push(nowMs);
      page.isSeeking = true;
      player.seek(Math.floor(random() * numFrames), ++seeks);
    },
    1000 * lastsS * ((n + 0.3 + 0.4 * random()) / 20),
  );
}
for (let n = 0; what === "seeks" && n < 3; n++) {
  add(
    () => {
      isStalled = true;
      disturbed.push(nowMs);
      player.playback.endFrame = player.playback.nextFrame;
      add(() => {
        isStalled = false;
        player.wake();
      }, 1500);
    },
    1000 * lastsS * ((n + 0.9) / 3.2),
  );
}

const endMs = nowMs + 1000 * lastsS;
while (nowMs < endMs) {
  const next = timers.reduce((a, b) => (b.atMs < a.atMs ? b : a));
  nowMs = Math.max(nowMs, next.atMs);
  if (next.everyMs === null) clear(next.id);
  else next.atMs += next.everyMs;
  next.run();
}
const heard = started.flatMap(({ atS, node }) => {
  const [data] = node.buffer.data;
  return [...data.keys()]
    .filter((at) => data[at] > 0.5 && atS + at / 48000 < node.stopS)
    .map((at) => ((atS + at / 48000 + LATENCY_S) / FASTER) * 1000);
});
process.stdout.write(
  JSON.stringify({
    heard,
    shown,
    disturbed,
    gaps: sound.gaps,
    stalls: player.playback.stalls,
    isOldWanted,
    endMs,
  }),
);
