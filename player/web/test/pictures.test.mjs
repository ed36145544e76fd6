/** What shows from the chunks that have come: scrubbing, updates that wait, the order of drawing. */
import assert from "node:assert/strict";
import { test } from "node:test";

import { MOVES } from "../constants.js";
import { readManifest, keyframeOf } from "../format/manifest.js";
import { readIndex, readObject } from "../format/objects.js";
import {
  DepthOrder,
  floatWords,
  latticeWords,
  NEVER,
  PendingUpdates,
  roomFor,
} from "../playback/depthorder.js";
import { KeyframePreview } from "../playback/keyframepreview.js";
import { addObject } from "../source/hosteddownload.js";
import { SegmentCache } from "../source/segmentcache.js";
import { filesOf, law, settled } from "./support.mjs";

const FILES = filesOf("one-lane");
const MANIFEST = readManifest(FILES["manifest.json"]);
const RECORDS = readIndex(FILES["index.bin"], MANIFEST);
const { segmentFrames } = MANIFEST;

/** A scrubber of a host that answers when told, and what it asked for and showed, in segments. */
function scrubbing() {
  const cache = new SegmentCache(MANIFEST);
  const asked = [];
  const shown = [];
  const fetchKeyframe = (segment, layer, signal) => {
    assert.equal(layer, 0);
    return new Promise((resolve, reject) => {
      const answer = () => {
        const packets = readObject(FILES[`segments/${segment}/keyframe-0`]);
        addObject(cache, RECORDS[segment], keyframeOf(MANIFEST, 0), packets);
        resolve(true);
      };
      asked.push({ segment, signal, answer, refuse: () => reject(new Error("gone")) });
    });
  };
  const numFrames = RECORDS.length * segmentFrames;
  const stream = { manifest: MANIFEST, cache, numFrames, fetchKeyframe };
  const calls = { fetches: 0 };
  const scrubber = new KeyframePreview(
    stream,
    ({ frame, isJoin, updates }) => {
      assert.ok(isJoin && updates.length > 0);
      shown.push(frame / segmentFrames);
    },
    () => (calls.fetches += 1),
  );
  return { scrubber, asked, shown, calls };
}

/** Waits for an event. */
async function until(holds) {
  while (!holds()) await settled();
}

test("scrubbing keeps one request underway, and the last target counts", async () => {
  const { scrubber, asked, shown, calls } = scrubbing();
  scrubber.scrub(0);
  for (const frame of [segmentFrames, 2 * segmentFrames]) scrubber.scrub(frame);
  assert.deepEqual(
    asked.map(({ segment }) => segment),
    [0],
  );
  asked[0].answer();
  await until(() => asked.length === 2);
  assert.deepEqual([shown, asked[1].segment, calls.fetches], [[0], 2, 2]);
  scrubber.scrub(0.6 * segmentFrames);
  asked[1].answer();
  await until(() => asked.length === 3);
  assert.deepEqual([shown, asked[2].segment], [[0, 2], 1]);
  scrubber.scrub(0.4 * segmentFrames);
  asked[2].refuse();
  await until(() => shown.length === 3);
  assert.deepEqual(shown, [0, 2, 0], "the next one, though that one cannot be had");
  scrubber.scrub(10 * segmentFrames);
  await until(() => shown.length === 4);
  assert.deepEqual([shown[3], asked.length], [2, 3], "at the end, from what has come");
});

test("scrubbing that ends aborts its request and shows nothing more, until it begins again", async () => {
  const { scrubber, asked, shown } = scrubbing();
  scrubber.scrub(0);
  scrubber.end();
  assert.deepEqual([asked[0].signal.aborted, scrubber.isActive], [true, false]);
  asked[0].answer();
  await until(() => !scrubber.isRunning);
  assert.deepEqual(shown, []);
  scrubber.scrub(segmentFrames);
  assert.deepEqual([asked[1].segment, asked[1].signal.aborted], [1, false]);
  asked[1].answer();
  await until(() => shown.length === 1);
  assert.deepEqual(shown, [1]);
});

const NUM_SLOTS = 50;
const SLOT_WORD = { lattice: 3, floats: 0 };
const KINDS = ["lattice", "floats"];

for (const shDegree of [0, 1]) {
  const widths = { lattice: latticeWords(shDegree), floats: floatWords(shDegree) };
  law(
    `the newest update of each slot of degree ${shDegree} waits, and no more than one`,
    4,
    (random) => {
      const pending = new PendingUpdates(NUM_SLOTS, shDegree);
      const [wanted, found] = [new Array(NUM_SLOTS).fill(0), new Array(NUM_SLOTS).fill(0)];
      for (let n = 0; n < 200; n++) {
        const none = new Uint32Array(0);
        const words = { frame: n, lattice: none, floats: none, leaving: none };
        for (const kind of KINDS) {
          const slots = new Set(
            Array.from({ length: random.integer(0, kind === "lattice" ? 19 : 3) }, () =>
              random.integer(0, NUM_SLOTS - 1),
            ),
          );
          words[kind] = roomFor(slots.size, widths[kind]);
          for (const [i, slot] of [...slots].entries()) {
            const first = i * widths[kind];
            wanted[slot] = random.integer(1, 2 ** 31 - 1); // renderers write the lattice first
            words[kind].fill(wanted[slot], first, first + widths[kind]);
            // What lies above the 24 bits of a slot is not part of it.
            words[kind][first + SLOT_WORD[kind]] = slot + random.choice([0, 2 ** 24, 2 ** 31]);
          }
        }
        const before = pending.numEntries;
        const isKept = pending.add(words);
        assert.ok(pending.numEntries <= NUM_SLOTS);
        assert.ok(isKept ? pending.numEntries >= before : pending.updates[0].frame === -1);
        if (random.number() > 0.05 && n < 199) continue;
        for (const taken of pending.take()) {
          for (const kind of KINDS) {
            for (let first = 0; first + widths[kind] <= taken[kind].length; first += widths[kind]) {
              const entry = taken[kind].subarray(first, first + widths[kind]);
              found[entry[SLOT_WORD[kind]] & 0xffffff] = entry[widths[kind] - 1];
            }
          }
        }
        assert.deepEqual([pending.numEntries, pending.updates], [0, []]);
        assert.deepEqual(found, wanted);
      }
    },
  );
}

law("what shows is drawn far first, and at equal depth the lower slot in front", 40, (random) => {
  const numSlots = random.choice([1, 30, 300]);
  const order = new DepthOrder(numSlots);
  assert.equal(order.farFirst(5, new Array(16).fill(0), 0).length, 0);
  const slots = Uint32Array.from({ length: numSlots }, (_, n) => n);
  const means = Float32Array.from({ length: 3 * numSlots }, () => random.integer(-20, 60) / 4);
  const starts = Int32Array.from(slots, () => random.choice([-3, 5, 6, NEVER]));
  order.put(slots, means, starts);
  const w2c = [1, 0, 0, 0, 0, 1, 0, 0, 0.5, 0.25, 1, 2, 0, 0, 0, 1];
  const depth = (slot) =>
    0.5 * means[3 * slot] + 0.25 * means[3 * slot + 1] + means[3 * slot + 2] + 2;
  const shows = [...slots].filter((slot) => starts[slot] <= 5 && depth(slot) > 0.5);
  shows.sort((a, b) => depth(b) - depth(a) || b - a);
  assert.deepEqual([...order.farFirst(5, w2c, 0.5)], shows);
});

test("a Gaussian that goes on counts as half way, and one that leaves stays behind it", () => {
  const order = new DepthOrder(2, 2);
  const w2c = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  const put = (zs, start, move) =>
    order.put(
      Uint32Array.of(0, 1),
      Float32Array.from(zs.flatMap((z) => [0, 0, z])),
      Int32Array.of(start, start),
      Uint8Array.of(move, 0),
    );
  put([2, 4], 0, 0);
  put([8, 4], 0, MOVES);
  assert.deepEqual([order.means[2], order.means[5]], [5, 4]);
  assert.deepEqual([...order.leave(Uint32Array.of(1), 3)], [1, 0, 0, 0]);
  put([8, 6], 3, 0);
  assert.deepEqual(
    [...order.farFirst(3, w2c, 0)],
    [0, 1, 2],
    "the one that left is drawn from its spare place",
  );
  assert.deepEqual([...order.leave(Uint32Array.of(0, 1), 3)], [], "they show from this frame on");
  assert.deepEqual([...order.farFirst(3, w2c, 0)], [0, 1]);
});
