/** Which objects of a static host are fetched, in which order, over which link. */
import assert from "node:assert/strict";
import { test } from "node:test";

import { readIndex, readObject } from "../format/objects.js";
import { readManifest } from "../format/manifest.js";
import { HostedDownload, RateEstimator, RequestWindow } from "../source/hosteddownload.js";
import { Fetcher } from "../source/fetcher.js";
import { HostedStream } from "../source/hosted.js";
import { LayerRule } from "../source/layerrule.js";
import { SegmentCache } from "../source/segmentcache.js";
import { answering, filesOf, manifestOf, settled } from "./support.mjs";

const NUM_SEGMENTS = 30;
const LAYER_BYTES = [300_000, 100_000, 100_000];
const KEYFRAME_BYTES = [150_000, 60_000, 60_000];
const SKIP_MAPS_BYTES = 10_000;
const NEED_BPS = 8 * (500_000 + SKIP_MAPS_BYTES);
const MANIFEST = manifestOf();
const RECORDS = Array.from({ length: NUM_SEGMENTS }, (_, segment) => ({
  segment,
  firstFrame: 30 * segment,
  numFrames: 30,
  psnrDb: [],
  objectBytes: [...LAYER_BYTES, SKIP_MAPS_BYTES, ...KEYFRAME_BYTES],
  objectSha256: [],
}));

/** How things stand: a fast link at `nextFrame`, unless `changes` says otherwise. */
const at = (nextFrame, changes = {}) => ({
  ...{ nextFrame, rateBps: 100 * NEED_BPS, paused: false, queuedBytes: 0, waitS: 0, rate: 1 },
  ...changes,
});

/** The objects that are asked for as things stand one after another, until nothing is worth it. */
function chosen(states, { first = 0, most = 3, isHere } = {}) {
  const rule = new LayerRule(MANIFEST, RECORDS, first, most, isHere);
  return states.map((state) => {
    const asked = [];
    for (;;) {
      const segment = rule.choose(state);
      if (segment === null) return asked;
      asked.push(...rule.parts(segment).map((part) => `${segment}/${MANIFEST.parts[part]}`));
      rule.add(segment);
      assert.ok(asked.length < 1000, "the rule asks for ever");
    }
  });
}

const ofPart = (asked, part) => asked.filter((name) => name.split("/")[1] === part);
const range = (end, part) => Array.from({ length: end }, (_, n) => `${n}/${part}`);

test("a fast link brings every layer once, and keyframes at the start alone", () => {
  const asked = chosen(RECORDS.map(({ firstFrame }) => at(firstFrame))).flat();
  const wanted = ["0", "1", "2", "skipmaps"].flatMap((part) => range(NUM_SEGMENTS, part));
  const keyframes = [0, 1, 2].map((layer) => `0/keyframe-${layer}`);
  assert.deepEqual(asked.sort(), [...wanted, ...keyframes].sort());
});

test("nine seconds of layer 0 come first, then other layers, and fifteen seconds at most", () => {
  const base = 8 * (LAYER_BYTES[0] + SKIP_MAPS_BYTES);
  // A play that begins over a link that carries far more is content with three.
  const cases = [
    [9, at(0, { rateBps: 2.2 * base })],
    [5, at(0, { rateBps: 3 * base })],
    [3, at(0)],
    [3, at(90)],
    [5, at(120)],
    [9, at(450)],
  ];
  for (const [seconds, state] of cases) {
    const [asked] = chosen([state]);
    const current = state.nextFrame / 30;
    assert.deepEqual(
      asked.slice(0, 3),
      ["keyframe-0", "skipmaps", "0"].map((part) => `${current}/${part}`),
    );
    const layers = asked.filter((name) => /\/\d$/.test(name));
    const wanted = Array.from({ length: seconds }, (_, n) => `${current + n}/0`);
    assert.deepEqual(layers.slice(0, seconds), wanted);
    assert.match(layers[seconds], /\/1$/);
    assert.equal(ofPart(asked, "0").length, 15);
  }
});

test("the next round of a loop is asked for before it begins", () => {
  const [asked] = chosen([at(-60)]);
  assert.deepEqual(asked.slice(0, 3), ["0/keyframe-0", "0/skipmaps", "0/0"]);
  assert.deepEqual(ofPart(asked, "0"), range(13, "0"), "two seconds less, which pass until then");
});

test("a link that carries layer 0 alone brings no other", () => {
  const [asked] = chosen([at(0, { rateBps: 8.5 * (LAYER_BYTES[0] + SKIP_MAPS_BYTES) })]);
  assert.deepEqual(
    asked.sort(),
    ["0/keyframe-0", ...range(15, "0"), ...range(15, "skipmaps")].sort(),
  );
});

test("a layer that comes back begins with its keyframe", () => {
  const [fast, slow, again] = chosen([at(0), at(300, { queuedBytes: 1e10 }), at(480)]);
  assert.ok(fast.includes("14/1"));
  assert.deepEqual(ofPart(slow, "1"), []);
  assert.equal(again[again.indexOf("16/1") - 1], "16/keyframe-1");
  const keyframes = again.filter((name) => name.includes("keyframe"));
  assert.deepEqual(keyframes, ["16/keyframe-1", "16/keyframe-2"]);
});

test("what would come more than half a segment late is not asked for, but in a pause", () => {
  const rateBps = 1.5 * NEED_BPS;
  for (const queuedBytes of [0, 2_000_000]) {
    const plannedS = (8 * (queuedBytes + LAYER_BYTES[1] + KEYFRAME_BYTES[1])) / (0.9 * rateBps);
    const [asked] = chosen([at(0, { rateBps, queuedBytes })]);
    const first = Math.min(...ofPart(asked, "1").map((name) => parseInt(name, 10)));
    assert.equal(first, Math.max(0, Math.ceil(plannedS - 0.5)));
  }
  const slow = { rateBps: 1.2 * NEED_BPS };
  const [playing] = chosen([at(25, slow)], { first: 25 });
  const [still] = chosen([at(25, { ...slow, paused: true })], { first: 25 });
  assert.ok(!playing.includes("0/2"));
  const first = ["keyframe-0", "skipmaps", "0", "keyframe-1", "1", "keyframe-2", "2"];
  assert.deepEqual(
    still.slice(0, 7),
    first.map((part) => `0/${part}`),
    "all layers come first",
  );
});

test("at double speed no more layers than the link carries then, and never more than wanted", () => {
  const states = [1, 2].map((rate) => at(25, { rateBps: 1.5 * NEED_BPS, rate }));
  const upper = states.map((state) => ofPart(chosen([state], { first: 25 })[0], "2").length);
  assert.ok(upper[0] > 0 && upper[1] === 0);
  const [asked] = chosen([at(0)], { most: 2 });
  assert.ok(ofPart(asked, "1").length > 0 && ofPart(asked, "2").length === 0);
});

test("what has come is not asked for again, at no cost to the link", () => {
  const isHere = ({ segment }, part) => segment === 1 && MANIFEST.parts[part] !== "skipmaps";
  const rateBps = 8.5 * (LAYER_BYTES[0] + SKIP_MAPS_BYTES);
  const [asked] = chosen([at(0, { rateBps })], { isHere });
  assert.equal(String(asked.filter((name) => name.startsWith("1/"))), "1/skipmaps");
});

test("the rate follows the link", () => {
  const estimator = new RateEstimator();
  estimator.add(1000, 0.001);
  assert.equal(estimator.rateBps, null, "too little to say");
  for (let n = 0; n < 50; n++) estimator.add(20_000, 0.02);
  const before = Number(estimator.rateBps);
  assert.ok(Math.abs(before / 8e6 - 1) < 0.01);
  estimator.add(0, 0.4);
  assert.ok(Number(estimator.rateBps) < 0.6 * before);
});

const FILES = filesOf("one-lane");
const STREAM = readManifest(FILES["manifest.json"]);
const INDEX = readIndex(FILES["index.bin"], STREAM);

for (const rateBps of [1e6, 1e9]) {
  test(`a play asks a host with ${rateBps} bits a second for every object once`, async () => {
    const asked = [];
    const stream = {
      manifest: STREAM,
      records: INDEX,
      estimator: { rateBps, add() {} },
      absent: new Map(),
      window: new RequestWindow(),
      cache: new SegmentCache(STREAM),
      async object({ segment }, part) {
        const name = `${segment}/${STREAM.parts[part]}`;
        asked.push(name);
        return readObject(FILES[`segments/${name}`]);
      },
    };
    let nowS = 0;
    const request = { firstFrame: 0, mostLayers: STREAM.numLayers, nowS: () => nowS };
    const play = new HostedDownload(stream, request);
    for (let frame = 0; frame < INDEX.length * STREAM.segmentFrames; frame++) {
      nowS = frame / STREAM.fps;
      play.reportPosition(frame, false, 1);
      play.step();
      assert.ok(frame > 0 || !play.isDone);
    }
    await settled();
    play.step();
    assert.equal(play.isDone, true);
    const layers = STREAM.parts.filter((part) => !part.startsWith("keyframe-"));
    const wanted = INDEX.flatMap(({ segment }) => layers.map((part) => `${segment}/${part}`));
    const first = STREAM.parts.filter((part) => part.startsWith("keyframe-"));
    assert.deepEqual(asked.sort(), [...wanted, ...first.map((part) => `0/${part}`)].sort());
  });
}

test("a try that breaks off is measured, and is under way again", () => {
  let count;
  const estimator = new RateEstimator();
  const large = (numBytes) => 1000 * numBytes;
  const records = INDEX.map((one) => ({ ...one, objectBytes: one.objectBytes.map(large) }));
  const stream = {
    ...{ manifest: STREAM, records, estimator, absent: new Map() },
    window: new RequestWindow(),
  };
  stream.cache = new SegmentCache(STREAM);
  stream.object = (_record, _part, onBytes) => {
    count ??= onBytes;
    return new Promise(() => {});
  };
  let nowS = 0;
  const play = new HostedDownload(stream, { firstFrame: 0, mostLayers: 1, nowS: () => nowS });
  play.step();
  const before = play.queuedBytes;
  for (let n = 1; n <= 9; n++) {
    nowS = n / 10;
    count(20_000);
    play.step();
  }
  const rateBps = Number(play.rateBps);
  assert.ok(Math.abs(rateBps / 1.6e6 - 1) < 0.01);
  count(-180_000);
  play.step();
  assert.deepEqual([play.rateBps, play.queuedBytes], [rateBps, before]);
  play.close();
});

test("a seek aborts what it does not need and keeps what it does, and that is no failure", async (context) => {
  const asked = [];
  answering(context, (url, { signal }) => {
    const name = url.split("/host/")[1];
    if (!name.startsWith("segments/")) return new Response(FILES[name]);
    asked.push({ name, signal });
    return new Promise((_, no) => signal.addEventListener("abort", () => no(signal.reason)));
  });
  const stream = await HostedStream.open("http://any/host/", new Fetcher());
  const firstFrame = 1;
  const play = stream.play({ firstFrame, mostLayers: STREAM.numLayers, nowS: () => 0 });
  play.step();
  await settled();
  assert.equal(play.moveTo(STREAM.segmentFrames + 1, "seek"), true);
  play.step();
  await settled();
  const layers = asked.filter(({ name }) => /[01]\/0$/.test(name));
  const found = layers.map(({ name, signal }) => `${name}: ${signal.aborted}`);
  assert.deepEqual(
    found.sort(),
    ["0/0: true", "1/0: false"].map((n) => `segments/${n}`),
  );
  assert.equal(play.failure, null);
  play.close();
  assert.equal(play.moveTo(0, "step"), false);
});
