/** When a page shows motion between frames. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { shareAt, Smoothing } from "../renderer/smoothing.js";
import { law } from "./support.mjs";

/** Number of intervals between pictures after which the screen's rate is known. */
const LEAST_INTERVALS = 5;

law("the share of the way grows from 0 to 1 between the due times of two frames", 200, (random) => {
  const [rate, fps] = [random.number(0.1, 2), random.choice([24, 30, 60])];
  const numFrames = random.integer(1, 300);
  const [round, frame] = [random.integer(0, 3), random.integer(0, numFrames - 1)];
  const way = random.number(0, numFrames < 4 ? Math.min(1.5, 0.7 * numFrames) : 1.5);
  const nowMs = 1e12 + (1000 * (round * numFrames + frame + way)) / (fps * rate);
  const share = shareAt(nowMs, { zeroMs: 1e12, rate }, frame, fps, numFrames);
  assert.ok(Math.abs(share - Math.min(way, 1)) < 0.02, `${share} of ${way}`);
  assert.equal(shareAt(nowMs, { zeroMs: null, rate }, frame, fps, numFrames), 1, "nothing runs");
});

/**
 * The pictures that a view shows on a screen of `hz`. busyMs: how much later than it could each one is
 * drawn, over and over. paused: the first picture in the pause, and the first one after it.
 */
function smoothed(
  hz,
  fps,
  { busyMs = [0], count = 300, interpolates = true, paused = [], moves = true } = {},
) {
  const inbetween = { share: 1, isMoving: moves };
  const line = { zeroMs: performance.timeOrigin, rate: 1 };
  let isAsked;
  const view = {
    session: { line, numFrames: 1000 },
    manifest: { fps, numGs: 1 },
    painter: { renderer: { inbetween } },
    ...{ headset: null, interpolates, isEmpty: false, needsDrawing: false, shownFrame: 0 },
    loop: { request: () => (isAsked = true) },
  };
  const smoothing = new Smoothing(view);
  const found = [];
  let [nowMs, zeroMs] = [0, 0];
  for (let n = 0; n < count; n++) {
    if (n === paused[0]) line.zeroMs = null;
    if (n === paused[1]) {
      zeroMs = nowMs - (1000 * view.shownFrame) / fps; // the frame that stands has its whole time
      line.zeroMs = performance.timeOrigin + zeroMs;
    }
    if (line.zeroMs !== null) view.shownFrame = Math.floor(((nowMs - zeroMs) / 1000) * fps + 1e-6);
    view.needsDrawing = isAsked = false;
    const isMoving = smoothing.step(nowMs);
    assert.ok(isAsked || !isMoving, "the next picture is asked for while it moves");
    const { needsDrawing: draws, shownFrame: frame } = view;
    found.push({ isMoving, isAsked, draws, frame, share: inbetween.share });
    // While nothing moves, pictures come with frames.
    const frameMs = zeroMs + (1000 * (view.shownFrame + 1)) / fps;
    const nextMs = isAsked ? nowMs + 1 : Math.max(nowMs + 1, frameMs);
    nowMs = (Math.ceil(((nextMs + busyMs[n % busyMs.length]) * hz) / 1000) * 1000) / hz;
  }
  return found;
}

for (const hz of [50, 60, 90, 120, 144]) {
  test(`a screen of ${hz} Hz shows motion between 30 frames a second`, () => {
    const found = smoothed(hz, 30);
    assert.ok(found.slice(LEAST_INTERVALS).every(({ isMoving }) => isMoving));
    const shares = found.slice(Math.floor(hz / 10)).map(({ share }) => share);
    assert.ok(new Set(shares.map((share) => share.toFixed(2))).size > 1);
    const mean = shares.reduce((sum, share) => sum + share) / shares.length;
    assert.ok(mean > 0.2 && mean < 0.7);
  });
}

for (const rates of ["60 60", "30 30", "60 59.94", "50 60"]) {
  const [hz, fps] = rates.split(" ").map(Number);
  test(`a screen of ${hz} Hz shows ${fps} frames a second as they are`, () => {
    const found = smoothed(hz, fps, { count: 400 });
    assert.ok(!found.some(({ isMoving, draws, share }) => isMoving || draws || share < 1));
    // The screen is measured from time to time by a few pictures.
    const numAsked = found.filter(({ isAsked }) => isAsked).length;
    assert.ok(numAsked >= 2 * LEAST_INTERVALS && numAsked <= 25);
  });
}

law("a pause shows an exact frame, and later pictures never go back behind it", 30, (random) => {
  const first = random.integer(20, 200);
  const end = first + random.integer(1, 100);
  const found = smoothed(60, random.choice([3, 24, 30]), { paused: [first, end] });
  assert.ok(found.slice(first, end).every(({ share }) => share === 1));
  for (const [n, { frame, share }] of found.slice(1).entries())
    assert.ok(frame > found[n].frame || share >= found[n].share);
  const last = found[end - 1].frame;
  const later = found.slice(end).filter(({ frame }) => frame > last);
  assert.ok(later.length === 0 || Math.min(...later.map(({ share }) => share)) < 0.6);
});

test("nothing is drawn anew where nothing moves, or where a viewer wants no motion", () => {
  assert.ok(!smoothed(120, 30, { moves: false }).some(({ draws }) => draws));
  const found = smoothed(120, 30, { interpolates: false });
  assert.ok(!found.some(({ isMoving, draws }) => isMoving || draws));
});

test("a page that is busy counts as slow, and is measured again once it no longer is", () => {
  const busyMs = [...new Array(30).fill(50), ...new Array(400).fill(0)];
  const moving = smoothed(60, 30, { busyMs, count: 400 }).map(({ isMoving }) => isMoving);
  assert.ok(!moving.slice(0, 40).every(Boolean));
  assert.ok(moving.slice(-100).every(Boolean));
});
