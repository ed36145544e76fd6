/**
 * Clips with clicks in virtual time: the real player of a worker and the real sound of a page, on clocks
 * that run apart, with a device that plays what it is given. Each click is heard with its frame.
 */
import assert from "node:assert/strict";
import { test } from "node:test";
import { FrameAssembler } from "../playback/frameassembler.js";
import { PlayController } from "../playback/playcontroller.js";
import { ChunkFeed } from "../playback/playsession.js";
import { SoundPlay } from "../sound/soundplay.js";
import { SoundTrack } from "../sound/soundtrack.js";
import { manifestOf, Random } from "./support.mjs";

/** The device's clock runs faster than the page's. */
const FASTER = 1 + 2e-4;
const LATENCY_S = 0.06;
const CLICK_FRAMES = 15;
const APART_MS = 20;
/** Longest time for which earlier samples are heard: a frame until a stall is noticed, latency, fading. */
const HEARD_OUT_MS = 100 + 1000 / 30;

// Time: timers run one after another, each with what was posted meanwhile.
let nowMs = 1000;
let timers = new Map();
let ids = 0;
function add(run, ms = 0, everyMs = null) {
  timers.set(++ids, { atMs: nowMs + Math.max(0.01, ms), run, everyMs });
  return ids;
}
Object.assign(globalThis, {
  setTimeout: (run, ms) => add(run, ms),
  setInterval: (run, ms) => add(run, ms, ms),
  clearTimeout: (id) => timers.delete(id),
  clearInterval: (id) => timers.delete(id),
});
performance.now = () => nowMs;
let random = new Random(0);

let started = [];
const nothing = () => {};
const param = () => ({
  ...{ setValueAtTime: nothing, setTargetAtTime: nothing, cancelScheduledValues: nothing },
});
const deviceS = () => (nowMs / 1000) * FASTER;
class FakeContext extends EventTarget {
  state = "running";
  destination = {};
  get currentTime() {
    return Math.floor(deviceS() * 375) / 375; // in blocks of 128 samples
  }
  getOutputTimestamp() {
    const contextTime = deviceS() - LATENCY_S + random.number(-0.002, 0.002);
    return { contextTime, performanceTime: nowMs };
  }
  createGain() {
    return { gain: param(), connect: nothing, disconnect: nothing };
  }
  createBuffer(numChannels, length) {
    const data = Array.from({ length: numChannels }, () => new Float32Array(length));
    const copyToChannel = (from, n) => data[n].set(from);
    return { data, copyToChannel };
  }
  createBufferSource() {
    const node = {
      ...{ buffer: null, stopS: Infinity, connect: nothing, disconnect: nothing },
      start: (atS) => started.push({ atS, node }),
      stop: (atS) => (node.stopS = atS),
    };
    return node;
  }
  async resume() {}
  async suspend() {}
}
Object.assign(globalThis, { AudioContext: FakeContext });

/**
 * Plays a clip of `numFrames` frames in a loop for `lastsS`, while other things happen; says when clicks
 * were heard and their frames showed, in milliseconds of the page's clock.
 */
function played({ fps = 30, numFrames, lastsS, seed = 1, live = false, happen = nothing }) {
  random = new Random(seed);
  [timers, started] = [new Map(), []];
  const manifest = { ...manifestOf({ fps, segment_frames: 15, slots: [1] }), live };
  const clip = {
    isStalled: false,
    isOldWanted: false,
    lastsS,
    disturbedMs: [],
  };
  // Every frame is there, but for a stall; every piece has its clicks.
  const isThere = () => !clip.isStalled;
  const advance = () => ({ isJoin: false, updates: [] });
  const play = { has: isThere, canAdvance: isThere, join: () => [], again: () => [], advance };
  Object.assign(FrameAssembler.prototype, play);
  ChunkFeed.prototype.advance = nothing;
  SoundTrack.prototype.want = (pieces) => {
    const shownS = page.shownFrame / fps;
    if (page.live && pieces.some(({ end }) => end / 48000 < shownS - 0.1)) clip.isOldWanted = true;
  };
  SoundTrack.prototype.samples = (begin) => {
    const made = new Float32Array(sound.timeline.pieceAt(begin).end - begin);
    for (let frame = 0; frame < page.numFrames; frame += CLICK_FRAMES) {
      const at = Math.floor((frame * 48000) / fps) - begin;
      if (at >= 0 && at < made.length) made[at] = 1;
    }
    return [made];
  };
  const cache = {
    ...{ setPlayhead: nothing, segmentOf: () => 0, listeners: new Set(), ranges: () => [] },
    packet: () => null,
    ...{ endOf: () => 0, keyframe: () => null, hasRoomFor: () => true, baseBps: () => 0 },
  };
  const source = () => ({
    ...{ step: () => 1, reportPosition: nothing, moveTo: () => false, close: nothing },
    ...{ rateBps: null, failure: null, isDone: true },
  });
  const page = Object.assign(new EventTarget(), {
    manifest: { ...manifest, sound: [{ name: "main", channels: 1, keys: [] }] },
    ...{ base: "http://x/", source: null, numFrames, live, line: null },
    ...{ shownFrame: -1, isSeeking: false },
    workers: { post: (data) => add(() => player.follow(data), 1) },
  });
  const flashes = [];
  let seeks = 0;
  const outlet = {
    post: (message) => {
      if (message.kind === "ended") add(() => page.dispatchEvent(new Event("ended")), 1);
      if (message.kind !== "line") return;
      add(() => {
        page.line = message;
        page.dispatchEvent(new Event("line"));
      }, 1);
    },
    // A picture is sorted, and waits for the next one of the browser.
    show: (one) => {
      const readyMs = nowMs + random.number(2, 8);
      const frameMs = 1000 / 60;
      const shows = () => {
        page.shownFrame = one.frame;
        if (one.seeks === seeks) page.isSeeking = false;
        if (one.frame % CLICK_FRAMES === 0) flashes.push(nowMs);
        page.dispatchEvent(new Event("shown"));
      };
      add(shows, Math.ceil(readyMs / frameMs) * frameMs - nowMs);
    },
    fail: assert.ifError,
  };
  const stream = { manifest, numFrames, cache, base: "", files: null, play: source };
  const player = new PlayController(stream, {}, outlet, {
    loop: true,
  });
  const sound = new SoundPlay(page, () => player.loop);
  const seek = (frame) => {
    page.isSeeking = true;
    player.seek(frame, ++seeks);
  };
  const grow = (frames, isLive) => {
    page.numFrames = stream.numFrames += frames;
    page.live = manifest.live = isLive;
    player.grow();
    page.dispatchEvent(new Event("grown"));
  };
  player.setPlaying(true);
  player.wake();
  happen(Object.assign(clip, { player, seek, grow }));
  const endMs = nowMs + 1000 * lastsS;
  while (nowMs < endMs) {
    const [id, next] = [...timers].reduce((a, b) => (b[1].atMs < a[1].atMs ? b : a));
    nowMs = Math.max(nowMs, next.atMs);
    if (next.everyMs === null) timers.delete(id);
    else next.atMs += next.everyMs;
    next.run();
  }
  sound.close();
  player.close();
  const clicks = started.flatMap(({ atS, node }) => {
    const [data] = node.buffer.data;
    return [...data.keys()]
      .filter((at) => data[at] > 0.5 && atS + at / 48000 < node.stopS)
      .map((at) => ((atS + at / 48000 + LATENCY_S) / FASTER) * 1000)
      .filter((atMs) => atMs < endMs - 100);
  });
  const { stalls } = player.playback;
  return { ...clip, clicks, flashes, gaps: sound.gaps, stalls };
}

/** Fails unless each click comes with a flash. */
function checkInStep(clicks, flashes) {
  for (const click of clicks) {
    const apartMs = Math.min(...flashes.map((flash) => Math.abs(flash - click)));
    assert.ok(apartMs <= APART_MS, `a click at ${click} ms is ${apartMs} ms apart`);
  }
}

for (const seed of [7, 8]) {
  test(`five minutes with seeks, stalls and clocks that run apart (seed ${seed})`, () => {
    const [numFrames, lastsS] = [300, 300];
    const found = played({
      ...{ numFrames, lastsS, seed },
      happen: (clip) => {
        const disturb = (how, share) =>
          add(
            () => {
              clip.disturbedMs.push(nowMs);
              how();
            },
            1000 * lastsS * share,
          );
        for (let n = 0; n < 20; n++)
          disturb(
            () => clip.seek(random.integer(0, numFrames - 1)),
            (n + random.number(0.3, 0.7)) / 20,
          );
        const stall = () => {
          clip.isStalled = true;
          clip.player.playback.endFrame = clip.player.playback.nextFrame;
          add(() => {
            clip.isStalled = false;
            clip.player.wake();
          }, 1500);
        };
        for (let n = 0; n < 3; n++) disturb(stall, (n + 0.9) / 3.2);
      },
    });
    assert.deepEqual([found.stalls, found.gaps, found.disturbedMs.length], [3, 0, 23]);
    assert.ok(found.clicks.length > (0.9 * lastsS * 30) / CLICK_FRAMES);
    const isOld = (atMs) =>
      found.disturbedMs.some((seekMs) => atMs > seekMs && atMs < seekMs + HEARD_OUT_MS);
    checkInStep(
      found.clicks.filter((click) => !isOld(click)),
      found.flashes,
    );
  });
}

test("a live stream goes on with its sound, and loops once it is finished", () => {
  const lastsS = 60;
  const found = played({
    ...{ numFrames: 60, lastsS, live: true },
    happen: ({ grow }) => {
      for (let ms = 500; ms < 500 * lastsS; ms += 500) add(() => grow(15, true), ms);
      add(() => grow(7, false), 500 * lastsS);
    },
  });
  assert.deepEqual([found.stalls, found.gaps, found.isOldWanted], [0, 0, false]);
  const missing = found.flashes.length - found.clicks.length;
  assert.ok(missing >= 0 && missing <= 2);
  checkInStep(found.clicks, found.flashes);
  const clicks = found.clicks.sort((a, b) => a - b);
  assert.ok(
    clicks.every((click, n) => n === 0 || click - clicks[n - 1] < 550),
    "none is left out",
  );
});

test("a loop that is switched off near its end is silent after it", () => {
  const happen = ({ player }) => add(() => (player.loop = false), 6000 - 400);
  const { clicks, flashes } = played({ numFrames: 90, lastsS: 12, happen });
  assert.equal(flashes.length, (2 * 90) / CLICK_FRAMES);
  const missing = flashes.length - clicks.length;
  assert.ok(missing >= 0 && missing <= 1, "the first one may come before the sound");
  checkInStep(clicks, flashes);
});

test("many short rounds stay in step", () => {
  // A round of 3 frames at 29.97 fps has 4804.8 samples.
  const found = played({ fps: 29.97, numFrames: 3, lastsS: 200 });
  assert.deepEqual([found.stalls, found.gaps], [0, 0]);
  assert.ok(found.clicks.length > 0.9 * found.flashes.length);
  checkInStep(found.clicks, found.flashes);
});
