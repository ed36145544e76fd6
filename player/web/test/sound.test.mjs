import assert from "node:assert/strict";
import { test } from "node:test";
import { SoundRun, stretched } from "../sound/soundrun.js";
import { FetchPace, heardAt, SoundTrack } from "../sound/soundtrack.js";
import { Timeline } from "../sound/timeline.js";
import { law, settled } from "./support.mjs";

const RATE = 48000;

/** A timeline of `numFrames` frames. */
function timelineOf([fps, segmentFrames, numFrames], live = false) {
  const timeline = new Timeline(fps, segmentFrames);
  timeline.reach(numFrames, live);
  return timeline;
}

law("pieces cover a stream once, and each lies in its segment", 200, (random) => {
  const fps = random.choice([23.976, 24, 29.97, 30, 60, 1000]);
  const [segmentFrames, numFrames] = [random.integer(1, 300), random.integer(1, 2000)];
  const live = random.number() < 0.5;
  const timeline = timelineOf([fps, segmentFrames, numFrames], live);
  // The last segment of a live stream may grow, so that it does not count.
  const counted = live ? numFrames - (numFrames % segmentFrames) : numFrames;
  const sampleOf = (frame) => Math.floor((Math.min(frame, counted) * RATE) / fps);
  assert.equal(timeline.length, sampleOf(counted));
  if (timeline.length === 0) return;
  const begin = random.integer(0, timeline.length - 1);
  const pieces = timeline.piecesFrom(begin, timeline.length, false, 1000);
  assert.ok(pieces[0].begin <= begin && begin < pieces[0].end);
  assert.ok(pieces.length === 1000 || pieces[pieces.length - 1].end === timeline.length);
  for (const [n, piece] of pieces.entries()) {
    const first = piece.segment * segmentFrames;
    assert.ok(n === 0 || pieces[n - 1].end === piece.begin);
    assert.ok(sampleOf(first) <= piece.begin && piece.end <= sampleOf(first + segmentFrames));
    assert.ok(piece.end - piece.begin <= 2 * RATE);
  }
});

law("a sample belongs to the round of a loop that has begun last", 100, (random) => {
  const timeline = timelineOf([random.choice([23.976, 29.97, 30]), 15, random.integer(1, 90)]);
  for (let n = 0; n < 20; n++) {
    const round = random.integer(0, 400);
    const begin = timeline.beginOf(round);
    assert.deepEqual([timeline.roundOf(begin), timeline.roundOf(begin - 1)], [round, round - 1]);
  }
});

test("pieces go on at the start of a stream that loops, and are as many as wanted", () => {
  const timeline = timelineOf([30, 30, 60]);
  const segments = (loops, most = 100) =>
    timeline.piecesFrom(1.5 * RATE, 3 * RATE, loops, most).map(({ segment }) => segment);
  assert.deepEqual(
    [segments(true), segments(false), segments(true, 2)],
    [[1, 0, 1, 0], [1], [1, 0]],
  );
  assert.deepEqual(timelineOf([30, 30, 0]).piecesFrom(0, RATE, true, 9), []);
});

test("a seek aborts what is no longer wanted", async () => {
  const timeline = timelineOf([30, 30, 3000]);
  let [asked, aborted] = [[], []];
  const fetchObject = (segment, _, signal) => {
    asked.push(segment);
    return new Promise((_resolve, reject) =>
      signal.addEventListener("abort", () => {
        aborted.push(segment);
        reject(signal.reason);
      }),
    );
  };
  const fail = (error) => {
    throw error;
  };
  const source = { part: "audio-main", channels: 1, keys: [] };
  const track = new SoundTrack(source, timeline, fetchObject, fail, fail);
  const wants = [
    [0, false, [0, 1], []],
    [0, false, [], []],
    [1, false, [2], [0]],
    [50, false, [50, 51], [1, 2]],
    [50, true, [], []],
    [70, true, [70], [50, 51]],
  ];
  for (const [second, isFull, isAsked, isAborted] of wants) {
    [asked, aborted] = [[], []];
    track.want(timeline.piecesFrom(RATE * second, 5 * RATE, false, 100), 2, isFull);
    await settled();
    assert.deepEqual([asked, aborted], [isAsked, isAborted], `at second ${second}`);
  }
  track.close();
  assert.deepEqual(aborted, [50, 51, 70]);
});

for (const rate of [0.25, 0.7, 1, 1.9]) {
  test(`at a speed of ${rate}, a step makes at most half a second, and nothing is omitted`, () => {
    const timeline = timelineOf([30, 300, 3000]);
    let step = [];
    const param = { setValueAtTime() {}, setTargetAtTime() {} };
    const context = {
      currentTime: 0,
      createGain: () => ({ gain: param, connect() {} }),
      createBuffer: (_, length) => ({
        length,
        copyToChannel() {},
      }),
      createBufferSource: () => ({
        buffer: { length: 0 },
        connect() {},
        start(atS) {
          step.push([Math.round(RATE * atS), this.buffer.length]);
        },
      }),
    };
    const samples = (begin) => [new Float32Array(timeline.pieceAt(begin).end - begin)];
    const outputs = [[{ samples }, {}]];
    const run = new SoundRun(context, timeline, outputs, 0, rate);
    run.setLoops(false, 0);
    const steps = Array.from({ length: 100 }, () => {
      step = [];
      run.step();
      context.currentTime += 0.1;
      return step;
    });
    const parts = steps.flat();
    assert.equal(run.gaps, 0);
    for (const [n, [at]] of parts.entries())
      assert.ok(n === 0 || parts[n - 1][0] + parts[n - 1][1] === at);
    const [at, length] = parts[parts.length - 1];
    assert.ok(at + length >= 10.8 * RATE);
    if (rate === 1) return;
    assert.ok(Math.max(...parts.map((part) => part[1])) <= 0.38 * RATE);
    const inSteps = steps.map((found) => found.reduce((sum, part) => sum + part[1], 0));
    assert.ok(Math.max(...inSteps) <= 0.63 * RATE);
  });
}

/** How often a tone crosses zero upwards, per second: its frequency. */
function pitchHz(samples) {
  const crossings = [...samples.keys()].filter(
    (n) => n > 0 && samples[n - 1] < 0 && samples[n] >= 0,
  );
  const [first, last] = [crossings[0], crossings[crossings.length - 1]];
  return ((crossings.length - 1) * RATE) / (last - first);
}

const stepsOf = (samples) =>
  Math.max(...samples.map((sample, n) => (n === 0 ? 0 : Math.abs(sample - samples[n - 1]))));

for (const rate of [0.25, 0.5, 0.75, 1.25, 1.5, 2]) {
  test(`a speed of ${rate} keeps the pitch, and joins what is around it without steps`, () => {
    const tone = Float32Array.from(
      { length: 24000 },
      (_, n) => 0.5 * Math.sin((2 * Math.PI * 440 * n) / RATE),
    );
    const length = Math.round(24000 / rate);
    const [left, right] = stretched([tone, tone.map((sample) => -sample)], length);
    assert.deepEqual([left.length, right.length], [length, length]);
    assert.ok(Math.abs(pitchHz(left) - 440) < 2);
    assert.deepEqual(
      right.map((sample) => -sample),
      left,
      "both channels move together",
    );
    assert.ok(stepsOf(left) <= 1.2 * stepsOf(tone));
    assert.ok(left.subarray(0, 500).every((sample, n) => Math.abs(sample - tone[n]) < 1e-6));
    const end = [left, tone].map((samples) => samples.slice(-3));
    assert.ok(end[0].every((sample, n) => Math.abs(sample - end[1][n]) < 1e-3));
  });
}

law("a piece of any length can have any speed", 60, (random) => {
  const count = random.integer(1, 9000);
  const length = Math.max(1, Math.round(count / random.number(0.25, 2)));
  const noise = Float32Array.from({ length: count }, () => random.number(-1, 1));
  const [made] = stretched([noise], length);
  assert.equal(made.length, length);
  assert.ok(made.every((sample) => Math.abs(sample) <= 1.0001));
});

/**
 * When the segments of `lengthMs` that each take `tookMs` came and are due: [ms, ms], while a feed plays
 * from the first one on.
 */
function paced(lengthMs, aheadMs, tookMs, rounds) {
  const pace = new FetchPace();
  const found = [];
  for (let nowMs = 0; nowMs < rounds * lengthMs; ) {
    const playedMs = Math.max(0, nowMs - tookMs);
    const dueMs = Math.max(0, found.length * lengthMs - playedMs);
    if (dueMs < Math.max(aheadMs, lengthMs) && pace.allows(dueMs, nowMs)) {
      pace.fetched(nowMs, nowMs + tookMs, lengthMs);
      nowMs += tookMs;
      found.push([nowMs, found.length * lengthMs + tookMs]);
    } else nowMs += 0.01 * lengthMs;
  }
  return found;
}

law("sound is in time, and what is not heard soon takes a small part of the link", 60, (random) => {
  const [lengthMs, aheadMs] = [random.number(1, 2000), random.number(500, 10000)];
  const share = random.number(0.02, 0.3);
  const tookMs = share * lengthMs;
  for (const [n, [cameMs, dueMs]] of paced(lengthMs, aheadMs, tookMs, 60).entries()) {
    assert.ok(cameMs <= dueMs + 1e-6);
    const soonMs = 300 + 3 * tookMs + lengthMs;
    const heardMs = Math.max(0, cameMs - tookMs);
    const mostShare = Math.max(1 / 5, share / 0.8);
    assert.ok(tookMs * (n + 1) <= share * (heardMs + soonMs) + mostShare * cameMs + 1e-6);
  }
});

law("the lead of the sound grows, however much of its length a segment takes", 20, (random) => {
  const found = paced(500, 15000, 500 * random.number(0.01, 0.7), 200);
  const [cameMs, dueMs] = found[found.length - 1];
  assert.ok(dueMs - cameMs > 13000);
});

test("a place without bounds is finite to a device", () => {
  const most = 1e308;
  const w2c = [0, 1, 0, 5, -1, 0, 0, 0, 0, 0, 1, -2, 0, 0, 0, 1];
  const [far, back] = [
    [0, most, -most, most],
    [1, -most, most, -most],
  ];
  const slow = [-most, most].map((timeS) => [timeS, 1, 2, 3]);
  for (const keys of [[[0, 1e39, -1e39, 0]], [far, back], slow]) {
    for (const timeS of [0, 0.25, 0.5, 2])
      assert.ok(Float32Array.from(heardAt(keys, timeS, w2c)).every(Number.isFinite));
  }
  assert.deepEqual(heardAt([[0, 1, 2, 3]], 0, w2c), [7, 1, -1]);
});
