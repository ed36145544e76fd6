import assert from "node:assert/strict";
import { test } from "node:test";

import { addObject, hasObject } from "../source/hosteddownload.js";
import { SegmentCache } from "../source/segmentcache.js";

/** The parts of a stream of two layers, after the changes of these. */
const [SKIP_MAPS, ...KEYFRAMES] = [2, 3, 4];
const NUM_FRAMES = 160;
const PACKET_BYTES = 872;
/** Bytes of a segment of `addWhole`, with 128 bytes more for each packet. */
const SEGMENT_BYTES = 9 * 1000;

const packet = (numBytes = 10) => new Uint8Array(numBytes);

/** A cache of two layers, of segments of a second with four frames. */
function made(limitSegments = 100) {
  const shape = { fps: 4, segmentFrames: 4, numLayers: 2 };
  return new SegmentCache(shape, limitSegments * SEGMENT_BYTES);
}

/** Adds a segment of layer 0. */
function addWhole(cache, ...segments) {
  for (const segment of segments) {
    for (let birth = 4 * segment; birth < 4 * segment + 4; birth++) {
      cache.add(birth, SKIP_MAPS, packet(PACKET_BYTES));
      cache.add(birth, 0, packet(PACKET_BYTES));
    }
    cache.add(4 * segment, KEYFRAMES[0], packet(PACKET_BYTES));
  }
}

const kept = (cache) => [...cache.segments.keys()].sort((a, b) => a - b).join(" ");
const rangesOf = (cache, numFrames) => cache.ranges(numFrames).join(" ");
const said = (...flags) => flags.map((flag) => (flag ? "yes" : "no")).join(" ");

test("a page that sets no limit keeps 64 MB", () => {
  const shape = { fps: 4, segmentFrames: 3, numLayers: 2 };
  const cache = new SegmentCache(shape);
  assert.deepEqual([cache.limitBytes, cache.numBytes], [64e6, 0]);
  assert.equal(cache.aheadSegments, 27);
  const short = new SegmentCache({ fps: 4, segmentFrames: 1, numLayers: 1 });
  short.setPlayhead(-2, null);
  assert.equal(short.playhead, 0);
});

test("a frame is there with its skip map and layer 0, the first of a segment also as a keyframe", () => {
  const cache = made();
  const ranges = () => rangesOf(cache, NUM_FRAMES);
  const has = (birth) => said(cache.hasSlice(birth), cache.hasFrame(birth));
  cache.add(5, 0, packet());
  assert.equal(ranges(), "");
  assert.equal(has(5), "no no");
  cache.add(5, SKIP_MAPS, packet(0));
  assert.equal(has(5), "yes yes");
  assert.equal(ranges(), "5,6");
  cache.add(6, 1, packet());
  cache.add(6, SKIP_MAPS, packet(0));
  assert.equal(ranges(), "5,6", "layer 1 alone is no frame");
  cache.add(4, KEYFRAMES[0], packet());
  assert.equal(has(4), "no yes");
  cache.add(8, KEYFRAMES[1], packet());
  assert.equal(ranges(), "4,6");
  assert.deepEqual(
    [cache.hasFrame(8), cache.hasFrame(-1), cache.packet(-1, SKIP_MAPS)],
    [false, false, null],
  );
  addWhole(cache, 0);
  assert.equal(ranges(), "0,6");
  assert.equal(cache.packet(0, SKIP_MAPS)?.length, PACKET_BYTES);
  cache.add(-4, SKIP_MAPS, packet());
  assert.equal(cache.packet(-4, SKIP_MAPS), null, "no frame is before the first one");
});

test("ranges are in order, join across segments and end with the stream", () => {
  const cache = made();
  addWhole(cache, 5, 3, 2);
  assert.equal(rangesOf(cache, NUM_FRAMES), "8,16 20,24");
  assert.equal(rangesOf(cache, 22), "8,16 20,22");
  const ends = [8, 11, 16, 20].map((frame) => cache.endOf(frame, 22));
  assert.deepEqual([...ends, cache.endOf(8, 10)], [16, 16, 16, 22, 10]);
});

test("a packet is kept once, and reaches the listeners", () => {
  const cache = made();
  const heard = [];
  cache.listeners.add((...what) => heard.push(what));
  const [one, other] = [packet(100), packet(900)];
  cache.add(5, SKIP_MAPS, one);
  cache.add(5, SKIP_MAPS, other);
  cache.add(6, 1, one);
  cache.add(8, KEYFRAMES[1], other);
  cache.add(8, KEYFRAMES[1], one);
  assert.deepEqual(heard, [
    [5, SKIP_MAPS, one],
    [6, 1, one],
    [8, KEYFRAMES[1], other],
  ]);
  assert.equal(cache.numBytes, 3 * 128 + 100 + 100 + 900);
  assert.equal(cache.segments.get(1)?.numBytes, 2 * 128 + 200);
  assert.equal(cache.packet(5, SKIP_MAPS), one);
  assert.deepEqual(
    [cache.packet(4, SKIP_MAPS), cache.packet(6, SKIP_MAPS), cache.packet(40, SKIP_MAPS)],
    [null, null, null],
  );
  assert.equal(cache.packet(6, 1), one);
  const missing = [cache.packet(6, 0), cache.packet(7, 1), cache.packet(41, 1)];
  assert.deepEqual(missing, [null, null, null]);
  assert.equal(cache.keyframe(2, 1), other);
  const others = [cache.keyframe(2, 0), cache.keyframe(1, 1), cache.keyframe(9, 1)];
  assert.deepEqual(others, [null, null, null]);
});

test("an object brings all packets of a part; a frame without one is unchanged", () => {
  const cache = made();
  const record = { firstFrame: 4, numFrames: 3 };
  const [one, other] = [packet(1), packet(2)];
  const packets = new Map([[4, one]]).set(6, other).set(7, other);
  addObject(cache, record, SKIP_MAPS, packets);
  addObject(cache, record, 1, packets);
  const wanted = [null, one, packet(0), other, null];
  for (const of of [(birth) => cache.packet(birth, SKIP_MAPS), (birth) => cache.packet(birth, 1)])
    assert.deepEqual([3, 4, 5, 6, 7].map(of), wanted);
  assert.equal(cache.packet(4, 0), null);
  addObject(cache, record, KEYFRAMES[0], new Map([[5, one]]));
  assert.equal(cache.keyframe(1, 0), null, "of another frame");
  addObject(cache, record, KEYFRAMES[1], packets);
  assert.deepEqual([cache.keyframe(1, 0), cache.keyframe(1, 1)], [null, one]);
});

test("which objects are whole", () => {
  const cache = made();
  const has = (part) => hasObject(cache, 1, part, 3);
  assert.equal(has(SKIP_MAPS), false, "nothing of the segment");
  for (const birth of [4, 5]) cache.add(birth, SKIP_MAPS, packet());
  assert.equal(has(SKIP_MAPS), false);
  assert.equal(hasObject(cache, 1, SKIP_MAPS, 2), true);
  cache.add(6, SKIP_MAPS, packet());
  assert.equal(has(SKIP_MAPS), true);
  for (const birth of [6, 5]) cache.add(birth, 1, packet());
  assert.equal(has(1), false, "without the first frame");
  cache.add(4, 1, packet());
  assert.deepEqual([has(1), has(0)], [true, false]);
  cache.add(4, KEYFRAMES[1], packet());
  assert.deepEqual([has(KEYFRAMES[1]), has(KEYFRAMES[0])], [true, false]);
  assert.deepEqual([cache.missingKeyframes(1, 2), cache.missingKeyframes(1, 1)], [[0], [0]]);
  assert.deepEqual(cache.missingKeyframes(2, 2), [0, 1]);
});

test("a segment continues the one before with all slices but the first, which keyframes replace", () => {
  const cache = made();
  // With one layer, and with both.
  const complete = () => said(...[1, 2].map((layers) => cache.isComplete(1, 3, layers)));
  const changes = () => said(...[1, 2].map((layers) => cache.hasAllChanges(1, 3, layers)));
  assert.deepEqual([complete(), changes()], ["no no", "no no"]);
  for (const birth of [5, 6]) cache.add(birth, 0, packet());
  cache.add(6, SKIP_MAPS, packet());
  assert.equal(changes(), "no no", "a skip map is missing");
  cache.add(5, SKIP_MAPS, packet());
  assert.deepEqual([complete(), changes()], ["no no", "yes no"]);
  cache.add(4, KEYFRAMES[0], packet());
  assert.equal(complete(), "yes no");
  cache.add(6, 1, packet());
  assert.equal(changes(), "yes no");
  cache.add(5, 1, packet());
  assert.deepEqual([complete(), changes()], ["yes no", "yes yes"]);
  cache.add(4, SKIP_MAPS, packet());
  assert.equal(complete(), "yes no", "neither keyframe nor change of layer 1");
  cache.add(4, 1, packet());
  assert.equal(complete(), "yes yes");
  const masked = made();
  masked.add(4, 0, packet());
  for (const birth of [5, 6]) {
    masked.add(birth, SKIP_MAPS, packet());
    masked.add(birth, 0, packet());
  }
  assert.equal(masked.isComplete(1, 3, 1), false, "a change without its skip map");
  const upper = made();
  for (const birth of [5, 6]) {
    upper.add(birth, SKIP_MAPS, packet());
    upper.add(birth, 1, packet());
  }
  assert.equal(upper.hasAllChanges(1, 3, 2), false, "layer 1 without layer 0");
  const bare = made();
  bare.add(4, KEYFRAMES[0], packet());
  assert.equal(bare.isComplete(1, 3, 1), false, "a keyframe alone");
});

test("the least recently used segment goes, but never what plays within twenty seconds", () => {
  const cache = made(5);
  addWhole(cache, 30, 31, 32, 0, 1);
  cache.setPlayhead(4 * 30 + 3, null);
  cache.setPlayhead(-2, null);
  assert.equal(cache.playhead, 0);
  const found = [2, 3, 4, 5, 25].map((segment) => {
    addWhole(cache, segment);
    if (segment === 4) assert.equal(cache.numBytes, 5 * SEGMENT_BYTES);
    return `${kept(cache)}: ${cache.hasRoomFor(6) ? "room" : "no room"}`;
  });
  const wanted = ["0 1 2 30 32", "0 1 2 3 30", "0 1 2 3 4", "0 1 2 3 4 5", "0 1 2 3 4 5 25"];
  assert.deepEqual(
    found,
    wanted.map((one, n) => `${one}: ${n < 2 ? "room" : "no room"}`),
  );
  cache.setPlayhead(4 * 6, null);
  addWhole(cache, 26, 27);
  assert.equal(kept(cache), "4 5 25 26 27", "what lies behind goes, the oldest first");
});

test("as many segments go as a packet needs", () => {
  const cache = made(3);
  addWhole(cache, 30, 31, 32);
  cache.add(0, SKIP_MAPS, packet(SEGMENT_BYTES));
  assert.equal(kept(cache), "0 32");
});

test("what plays in exactly twenty seconds stays", () => {
  const cache = made(1);
  addWhole(cache, 20, 21, 0);
  assert.equal(kept(cache), "0 20");
});

test("in a loop what has just played is needed last", () => {
  const cache = made(5);
  addWhole(cache, 5, 6, 7, 8, 9);
  cache.setPlayhead(4 * 10, NUM_FRAMES - 1);
  assert.equal(cache.loopSegments, 40, "a last segment that is cut short counts");
  addWhole(cache, 10, 11);
  assert.equal(kept(cache), "5 6 7 10 11");
  assert.equal(cache.numBytes, 5 * SEGMENT_BYTES);
  // Segment 6 plays after 10, 11 and 5; segment 9 after all others.
  const rooms = [6, 7, 8, 9].map((segment) => cache.hasRoomFor(segment));
  assert.equal(said(...rooms), "yes yes no no");
  addWhole(cache, 12);
  assert.equal(kept(cache), "5 6 10 11 12");
  const tight = made(1);
  tight.setPlayhead(0, NUM_FRAMES);
  addWhole(tight, 0, 1, 2);
  assert.equal(kept(tight), "0 1 2", "the newest stays, and what shows and comes next");
  addWhole(tight, 38);
  assert.equal(kept(tight), "0 1 38");
  tight.setPlayhead(4 * 39, NUM_FRAMES);
  assert.equal(said(tight.hasRoomFor(0), tight.hasRoomFor(1)), "yes no", "the first comes next");
  addWhole(tight, 37);
  assert.equal(kept(tight), "0 37");
});

test("a segment that shows, or comes next, is always asked for", () => {
  const cache = made(2);
  cache.setPlayhead(4 * 7, null);
  addWhole(cache, 7, 8);
  const asked = (...segments) => said(...segments.map((n) => cache.hasRoomFor(n)));
  assert.equal(asked(7, 8, 9, 6), "yes yes no no");
  cache.limitBytes = 1;
  assert.equal(asked(7, 8), "yes yes");
  cache.limitBytes = 2 * SEGMENT_BYTES + 1;
  assert.equal(asked(9, 6), "yes yes");
  cache.add(4 * 9, SKIP_MAPS, packet());
  assert.equal(asked(9), "yes", "what it has itself does not count");
});
