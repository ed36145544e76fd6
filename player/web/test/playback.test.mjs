import assert from "node:assert/strict";
import { test } from "node:test";

import { Playback } from "../playback/playback.js";
import { edgeFrame } from "../source/liveedge.js";
import { law } from "./support.mjs";

/** Binary fractions, so that times are exact. */
const FPS = 8;
const STEP_S = 1 / FPS;

/** A play of which the frames before `end` have come, and a playback of it. */
function made({ end = Infinity, fps = FPS, numFrames = 100, first = 0, notBeforeS } = {}) {
  const play = {
    end,
    isLate: false,
    has: (frame) => frame < play.end,
    canAdvance: (frame, most) => {
      assert.equal(most, playback.numFrames);
      return frame !== first && frame < play.end; // the first one comes as a keyframe
    },
    join: (frame) => [`join ${frame}`],
    again: (frame) => [`again ${frame}`],
    advance: (frame) => ({ isJoin: false, updates: [`${frame}`] }),
  };
  const playback = new Playback(play, fps, numFrames, first, notBeforeS);
  return { play, playback };
}

/** One that shows frame 0 and runs: frame 1 is due at 1 s. */
function running(how) {
  const both = made(how);
  const { playback } = both;
  playback.setPlaying(true);
  assert.equal(playback.tick(0)?.isJoin, true);
  assert.equal(playback.tick(1 - 1 / playback.fps), null);
  assert.equal(playback.dueS, 1);
  return both;
}

test("the first frame shows once it is there", () => {
  const { play, playback } = made({ end: 5, first: 5 });
  const { isJoined, live, playing, endFrame } = playback;
  assert.deepEqual([isJoined, live, playing, endFrame], [false, false, false, 5]);
  assert.deepEqual([playback.frame, playback.waiting], [5, true]);
  assert.equal(playback.tick(0), null);
  assert.deepEqual([playback.frame, playback.waiting], [5, true]);
  play.end = 6;
  assert.deepEqual(playback.tick(0), { frame: 5, isJoin: true, updates: ["join 5"] });
  assert.deepEqual([playback.frame, playback.nextFrame, playback.endFrame], [5, 6, 6]);
  assert.equal(playback.waiting, false);
  assert.equal(playback.tick(9), null, "paused");
});

test("each frame shows when it is due, at the rate", () => {
  const { playback } = running();
  assert.equal(playback.tick(1 - 1e-9), null);
  assert.deepEqual(playback.tick(1), { frame: 1, isJoin: false, updates: ["1"] });
  assert.equal(playback.dueS, 1 + STEP_S);
  playback.setRate(2);
  assert.equal(playback.dueS, null);
  assert.equal(playback.tick(2), null);
  assert.equal(playback.dueS, 2 + STEP_S / 2);
  assert.equal(playback.tick(2 + STEP_S / 2)?.frame, 2);
  playback.setPlaying(false);
  assert.equal(playback.dueS, null);
  assert.equal(playback.tick(50), null);
  playback.setPlaying(true);
  assert.equal(playback.tick(60), null);
  assert.equal(playback.tick(60 + STEP_S / 2)?.frame, 3);
});

test("frames that are due together show as one, with all their updates", () => {
  const { play, playback } = running();
  assert.deepEqual(playback.tick(1 + STEP_S), { frame: 2, isJoin: false, updates: ["1", "2"] });
  const isJoin = (frame) => frame === 4;
  play.advance = (frame) => ({ isJoin: isJoin(frame), updates: [`${frame}`] });
  const shown = playback.tick(1 + 4 * STEP_S);
  assert.deepEqual(shown, { frame: 5, isJoin: true, updates: ["4", "5"] }, "a join replaces all");
});

test("what is later than a quarter of a second shows at once, and the next is due from there", () => {
  const late = running().playback;
  assert.equal(late.tick(1.25)?.frame, 3, "exactly as late as may be");
  assert.equal(late.dueS, 1 + 3 * STEP_S);
  const { playback } = running();
  assert.equal(playback.tick(1.25 + 2 ** -20)?.frame, 1);
  assert.equal(playback.dueS, 1.25 + 2 ** -20 + STEP_S);
  const followed = running().playback;
  followed.follow(0.5);
  assert.equal(followed.dueS, 1.5);
  assert.equal(followed.tick(2.5)?.frame, 9, "sound goes on for a second");
  assert.equal(followed.tick(3.75 + 2 ** -20)?.frame, 10);
});

test("a frame that is missing is a stall until a tenth of a second has come", () => {
  const fps = 16;
  const { play, playback } = running({ fps, end: 3 });
  assert.equal(playback.tick(1 + 1 / fps)?.frame, 2);
  assert.deepEqual([playback.stalls, playback.waiting], [0, false]);
  assert.equal(playback.tick(1 + 2 / fps), null);
  assert.deepEqual([playback.stalls, playback.waiting, playback.dueS], [1, true, null]);
  play.end = 4; // a lead has two frames
  assert.equal(playback.tick(3), null);
  assert.deepEqual([playback.stalls, playback.waiting, playback.dueS], [1, true, null]);
  play.end = 5;
  assert.equal(playback.tick(4), null);
  assert.deepEqual([playback.waiting, playback.dueS], [false, 4 + 1 / fps]);
  for (const nowS of [5, 6, 7]) playback.tick(nowS);
  assert.deepEqual([playback.stalls, playback.waiting], [2, true]);
  playback.setPlaying(false);
  playback.tick(8);
  assert.equal(playback.waiting, false, "what is paused waits for nothing");
  const cut = running({ fps, end: 3 }).playback;
  assert.equal(cut.tick(1.25)?.frame, 2, "what is there shows before the stall");
  assert.equal(cut.stalls, 1);
});

/** The leads that are waited for after stalls that begin after `runsS` of playback each, seconds. */
function leads(runsS, { isLive = false, isThin = false } = {}) {
  const { play, playback } = made({ fps: 16, numFrames: 16_000, end: 1 });
  playback.live = isLive;
  playback.setPlaying(true);
  let nowS = 0;
  const waited = () => {
    const first = playback.nextFrame;
    playback.isLinkThin = isThin;
    for (;;) {
      play.end += 1;
      playback.heldFrame = play.end;
      assert.equal(playback.tick((nowS += 1 / 16)) ?? null, null);
      if (!playback.waiting) return (play.end - first) / 16;
    }
  };
  playback.tick(nowS);
  const found = [waited()];
  for (const runS of runsS) {
    const endS = nowS + runS;
    while (nowS < endS) {
      play.end = playback.nextFrame + 16;
      playback.tick((nowS += 1 / 16));
    }
    play.end = playback.endFrame;
    while (!playback.waiting) playback.tick((nowS += 1 / 16));
    found.push(waited());
  }
  return found;
}

test("the more often playback stalls, the more is waited for, and less again after a calm", () => {
  const one = 2 / 16; // two frames are the tenth of a second
  assert.deepEqual(leads([3, 3, 3, 3, 3]), [one, one, 1, 2, 4, 4]);
  assert.deepEqual(leads([3, 19, 21, 3]), [one, one, 1, one, 1]);
  assert.deepEqual(leads([3, 3, 3, 3], { isLive: true }), [one, one, 1, 2, 2]);
  assert.deepEqual(leads([3, 3, 3], { isThin: true }), [one, 1, 2, 4]);
  const { play, playback } = running({ fps: 16, end: 3, numFrames: 3 });
  Object.assign(playback, { live: true, isLinkThin: true });
  playback.tick(1.25);
  play.end = playback.heldFrame = playback.numFrames = 5;
  playback.tick(2);
  assert.deepEqual([playback.leadS, playback.waiting], [1, false], "no more frames exist");
});

test("what is not decoded yet counts as a longer lead, and a pause of a calm play as none", () => {
  const { play, playback } = running({ fps: 16, end: 3 });
  Object.assign(playback, { isLinkThin: true, heldFrame: 3 });
  playback.tick(1.25);
  assert.deepEqual([playback.stalls, playback.leadS, playback.isStuttering], [1, 1, false]);
  play.end = 5;
  playback.tick(2);
  assert.equal(playback.waiting, true);
  playback.heldFrame = 19;
  playback.tick(3);
  assert.deepEqual([playback.waiting, playback.resumedS], [false, 3]);
  playback.tick(3.25);
  assert.deepEqual([playback.leadS, playback.isStuttering], [2, true]);
  playback.setPlaying(false);
  playback.tick(4);
  assert.equal(playback.isStuttering, false);
  playback.setPlaying(true);
  play.end = 7;
  playback.tick(24);
  assert.deepEqual([playback.leadS, playback.waiting], [0.1, false], "20 s after it went on");
});

test("at the end of a stream no lead is needed, and nothing is due after it", () => {
  const { playback } = made({ fps: 16, numFrames: 2 });
  playback.setPlaying(true);
  playback.tick(0);
  assert.equal(playback.hasEnded, false);
  playback.tick(0);
  assert.equal(playback.tick(9)?.frame, 1);
  assert.deepEqual([playback.hasEnded, playback.frame, playback.endFrame], [true, 1, 2]);
  assert.equal(playback.tick(10), null);
  assert.deepEqual([playback.dueS, playback.stalls, playback.waiting], [null, 0, false]);
  const late = made({ numFrames: 3 }).playback;
  late.setPlaying(true);
  late.tick(0);
  late.tick(0);
  late.tick(STEP_S);
  assert.deepEqual(late.tick(9)?.updates, ["2"], "the loop over due frames ends with the stream");
});

test("a live stream has no end, and needs its whole lead", () => {
  const { playback } = made({ fps: 16, numFrames: 2 });
  playback.live = true;
  playback.setPlaying(true);
  playback.tick(0);
  assert.equal(playback.tick(0), null);
  assert.deepEqual([playback.waiting, playback.dueS], [true, null]);
  playback.numFrames = 3;
  playback.tick(1);
  assert.deepEqual([playback.waiting, playback.dueS], [false, 1 + 1 / 16]);
  playback.tick(1 + 2 / 16);
  assert.equal(playback.hasEnded, false);
  playback.live = false;
  assert.equal(playback.hasEnded, true);
});

test("a step goes to a later frame that is near and there", () => {
  const { play, playback } = made({ end: 90 });
  assert.equal(playback.stepTo(0), null, "nothing shows yet");
  playback.tick(0);
  for (const frame of [-1, 0, 31]) assert.equal(playback.stepTo(frame), null);
  assert.equal(playback.frame, 0);
  playback.setPlaying(true);
  playback.tick(0);
  const shown = playback.stepTo(30);
  assert.equal(shown?.frame, 30);
  assert.deepEqual(shown?.updates.length, 30);
  assert.deepEqual([playback.nextFrame, playback.dueS], [31, null]);
  assert.equal(playback.stepTo(31)?.frame, 31);
  playback.stepTo(60);
  assert.equal(playback.stepTo(90), null, "not there");
  play.end = 91;
  assert.equal(playback.stepTo(90)?.frame, 90);
});

test("a round begins when the one before is over, and goes on in its time", () => {
  const { playback } = made({ notBeforeS: 2 });
  playback.setPlaying(true);
  assert.equal(playback.isEarly(2 - 1e-9), true);
  assert.equal(playback.tick(1.5), null);
  assert.deepEqual([playback.waiting, playback.restS(1.5)], [false, 0.5]);
  assert.equal(playback.isEarly(2), false);
  assert.equal(playback.tick(2.125)?.frame, 0);
  assert.equal(playback.isEarly(1), false, "it shows");
  assert.equal(playback.dueS, 2 + STEP_S);
  assert.equal(playback.tick(2.125)?.frame, 1);
  const dueS = (nowS, how, isPlaying = true, rate = 1) => {
    const other = made({ notBeforeS: 2, ...how }).playback;
    other.setRate(rate);
    other.setPlaying(isPlaying);
    assert.equal(other.tick(nowS)?.frame, 0);
    return other.dueS;
  };
  assert.equal(dueS(2.25 - 2 ** -20, {}), 2 + STEP_S);
  assert.equal(dueS(2.25, {}), null, "too late for the time of the round before");
  assert.equal(dueS(2, { end: 1 }), null, "without a lead");
  assert.equal(dueS(2, {}, false), null, "paused");
  assert.equal(dueS(2, {}, true, 2), 2 + STEP_S / 2);
});

test("the due time of frame 0, by which the page knows all others", () => {
  const { playback } = made({ notBeforeS: 2, first: 4 });
  assert.equal(playback.zeroS(2), null, "paused");
  playback.setPlaying(true);
  assert.equal(playback.zeroS(1), 2 - 4 * STEP_S);
  assert.equal(playback.zeroS(2.25), null);
  playback.tick(2);
  assert.equal(playback.zeroS(2), 2 + STEP_S - 5 * STEP_S);
  playback.follow(0.25);
  assert.equal(playback.zeroS(2), 2.25 - 4 * STEP_S);
  playback.setRate(2);
  assert.equal(playback.zeroS(2), null, "it shows, and is not due before the next tick");
  playback.tick(3);
  assert.equal(playback.zeroS(3), 3 + STEP_S / 2 - (5 * STEP_S) / 2);
  const early = made({ notBeforeS: 2 }).playback;
  early.follow(0.5);
  assert.deepEqual([early.notBeforeS, early.dueS], [2.5, null]);
});

test("how long nothing is due", () => {
  const { play, playback } = running();
  assert.equal(playback.restS(0.75), 0.25);
  assert.equal(playback.restS(5), 0);
  playback.setPlaying(false);
  assert.equal(playback.restS(5), null);
  play.isLate = true;
  assert.equal(playback.restS(5), 0.2);
});

test("a paused picture is sent again when late data has come, at most five times a second", () => {
  const { play, playback } = made();
  playback.tick(-1);
  assert.equal(playback.tick(0), null);
  play.isLate = true;
  const again = { frame: 0, isJoin: true, updates: ["again 0"] };
  assert.deepEqual(playback.tick(0), again);
  assert.equal(playback.tick(0.1875), null);
  assert.deepEqual(playback.tick(0.2), again);
  assert.deepEqual(playback.resend(), again);
  playback.setPlaying(true);
  playback.tick(2);
  assert.equal(playback.tick(2 + STEP_S)?.isJoin, false, "a frame brings late data itself");
});

/**
 * Plays a stream of 300 frames, of which segments of 15 are made at `speed` times the rate of the stream,
 * are looked for every half second and take `delayS` to come.
 */
function lived(speed, delayS, beganS) {
  const [fps, segmentFrames, numFrames] = [30, 15, 300];
  const known = (nowS) => {
    const lookedS = Math.floor((nowS - delayS) / 0.5) * 0.5;
    const made = Math.floor((lookedS * fps * speed) / segmentFrames + 1e-9) * segmentFrames;
    return Math.max(0, Math.min(made, numFrames));
  };
  const first = edgeFrame({ fps, segmentFrames }, known(beganS));
  const { play, playback } = made({ fps, numFrames: known(beganS), first });
  playback.live = true;
  playback.setPlaying(true);
  const frames = [];
  let [ticks, waits] = [0, 0];
  for (; !playback.hasEnded; ticks++) {
    const nowS = beganS + ticks / 61;
    assert.ok(nowS < beganS + 40, "it ends");
    play.end = playback.heldFrame = playback.numFrames = known(nowS);
    playback.live = known(nowS) < numFrames;
    const shown = playback.tick(nowS);
    if (shown !== null) frames.push(shown.frame);
    waits += +playback.waiting;
    assert.ok(playback.frame < play.end);
  }
  assert.deepEqual(frames, [...Array(numFrames).keys()].slice(first));
  assert.equal(playback.waiting, false);
  return { stalls: playback.stalls, waitShare: waits / ticks };
}

law("at the edge of a stream that is made in its own time nothing is waited for", 20, (random) => {
  assert.equal(lived(1, random.number(0, 0.3), random.number(3, 6)).stalls, 0);
});

test("a stream that is made slower than it is shown is waited for at its edge", () => {
  const { stalls, waitShare } = lived(0.5, 0.1, 3.1);
  assert.ok(stalls > 3);
  assert.ok(waitShare > 0.25);
});
