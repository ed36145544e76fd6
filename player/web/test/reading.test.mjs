/** Captions, the records of a play, and the states and texts that the element shows. */
import assert from "node:assert/strict";
import { test } from "node:test";

import { Taps } from "../controls/gestures.js";
import { FrameRanges, NETWORK, Readiness, READY } from "../element/readiness.js";
import { frameTimeText, positionText, timeText } from "../controls/scrubber.js";
import { readCues, textAt } from "../format/captions.js";
import { ByteReader } from "../format/bytes.js";
import { readMap } from "../format/playrecord.js";

test("a browser is asked for each named escape once, and for no endless number of them", (t) => {
  let asked = 0;
  globalThis.VTTCue = class {
    constructor(...[, , text]) {
      asked += 1;
      this.getCueAsHTML = () => ({ textContent: text === "&eacute;" ? "\u00e9" : text });
    }
  };
  t.after(() => delete globalThis.VTTCue);
  const cue = (text) => readCues(`WEBVTT\n\n00:00.000 --> 00:01.000\n${text}`)?.[0].text;
  assert.equal(cue("&eacute;".repeat(1000)), "\u00e9".repeat(1000));
  assert.equal(asked, 1);
  const hostile = Array.from({ length: 20_000 }, (_, n) => `&n${n};`).join("");
  assert.equal(cue(hostile), hostile);
  assert.ok(asked < 5000);
});

test("the texts and times of WebVTT", () => {
  const cues = (...lines) => readCues(["WEBVTT", ...lines].join("\n"));
  const cue = { startS: 1.5, endS: 3723.004, text: "a" };
  for (const head of ["WEBVTT", "\ufeffWEBVTT", "WEBVTT - a title", "WEBVTT\tx"])
    assert.deepEqual(readCues(`${head}\r\n\r00:01.500 --> 01:02:03.004\na`)?.[0], cue);
  for (const head of ["", "WEBVTTx", " WEBVTT", "\ufeff\ufeffWEBVTT"])
    assert.equal(readCues(head), null);
  const text = (one) => cues("00:00.000 --> 00:01.000", one)?.[0]?.text;
  for (const [written, read] of [
    ["a <b>bold</b> word", "a bold word"],
    ["<v Ann", undefined],
    ["1 &lt; 2 &amp;&nbsp;3", "1 < 2 &\u00a03"],
    ["&#39;&#x20AC;&#xD800;&#0;&#1114112;", "'\u20ac\ufffd\ufffd\ufffd"],
    ["&; &#; &#x; &nosuch;", "&; &#; &#x; &nosuch;"],
  ])
    assert.equal(text(written), read);
  for (const times of [
    "00:0.5 --> 00:01.000",
    "00:60.000 --> 02:00.000",
    "00:02.000 --> 00:01.000",
  ])
    assert.deepEqual(cues(times, "a"), []);
  const two = "1\n00:00.000 --> 00:02.000 line:0\na\nb\n00:01.000 --> 00:03.000\nc\n\nd";
  const shown = [0, 0.999, 1, 2, 3].map((timeS) => textAt(cues(two), timeS));
  assert.deepEqual(shown, ["a\nb", "a\nb", "a\nb\nc", "c", ""]);
});

/** The map with one key "k" that msgpack has in these bytes, and what it holds. */
function valueOf(...bytes) {
  const reader = new ByteReader(Uint8Array.of(0x81, 0xa1, 0x6b, ...bytes), "play");
  const found = readMap(reader).get("k");
  assert.equal(reader.left, 0);
  return found;
}

test("the values of msgpack that records use", () => {
  const text = (one) => [...Buffer.from(one)];
  for (const [bytes, value] of [
    [[0x7f], 127],
    [[0xe0], -32],
    [[0xc0], null],
    [[0xc2], false],
    [[0xc3], true],
    [[0xca, 1, 2, 3, 4], null],
    [[0xcb, 1, 2, 3, 4, 5, 6, 7, 8], null],
    [[0xcc, 200], 200],
    [[0xcd, 1, 2], 258],
    [[0xce, 1, 0, 0, 2], 2 ** 24 + 2],
    [[0xcf, 0, 0, 1, 0, 0, 0, 0, 0], 2 ** 40],
    [[0xd0, 0x80], -128],
    [[0xd1, 0xff, 0xfe], -2],
    [[0xd2, 0xff, 0xff, 0xff, 0xfd], -3],
    [[0xd3, 255, 255, 255, 255, 255, 255, 255, 252], -4],
    [[0xa3, ...text("é!")], "é!"],
    [[0xd9, 1, 0x41], "A"],
    [[0xda, 0, 1, 0x41], "A"],
    [[0xdb, 0, 0, 0, 1, 0x41], "A"],
    [[0xc4, 2, 8, 9], Uint8Array.of(8, 9)],
    [[0xc5, 0, 1, 8], Uint8Array.of(8)],
    [[0xc6, 0, 0, 0, 1, 8], Uint8Array.of(8)],
    [[0xdc, 0, 1, 0xc4, 1, 7], [Uint8Array.of(7)]],
    [[0x91, 0xc5, 0, 1, 7], [Uint8Array.of(7)]],
    [[0xdd, 0, 0, 0, 0], []],
  ])
    assert.deepEqual(valueOf(...bytes), value);
  for (const bytes of [
    "c1",
    "80",
    "9105",
    "ddffffffff",
    "dbffffffff",
    "a1ff",
    "a241",
    "c600010000",
  ])
    assert.throws(() => valueOf(...Buffer.from(bytes, "hex")), { kind: "corrupt" }, bytes);
  const map = (...bytes) => readMap(new ByteReader(Uint8Array.from(bytes), "play"));
  assert.deepEqual([...map(0xde, 0, 1, 0xa1, 0x61, 1)], [["a", 1]]);
  assert.deepEqual([...map(0x82, 0xc4, 1, 0x61, 1, 0xa1, 0x62, 2)], [["b", 2]], "bytes as a key");
  for (const bytes of [[0x90], [0x81, 1, 1], [0xdf, 255, 255, 255, 255], []])
    assert.throws(() => map(...bytes), { kind: "corrupt" });
});

const LOADING = {
  ...{ fps: 10, frame: 0, endFrame: 0, numFrames: 100, live: false, waiting: true, playing: false },
  ...{ isShown: false, isSeeking: false, receivedBytes: 0 },
};

test("the states of loading, and their events in the order of HTML", () => {
  const readiness = new Readiness();
  assert.deepEqual(readiness.update(LOADING, 0), [], "nothing is open");
  assert.deepEqual(readiness.suspend(), []);
  assert.deepEqual([readiness.select(), readiness.network], [["loadstart"], NETWORK.LOADING]);
  assert.deepEqual([readiness.open(0), readiness.ready], [["loadedmetadata"], READY.METADATA]);
  const shows = { isShown: true, endFrame: 1 };
  const atEnd = { frame: 99, endFrame: 100 };
  const steps = [
    [0.1, { receivedBytes: 1 }, ["progress"], READY.METADATA],
    [0.2, { receivedBytes: 2 }, [], READY.METADATA],
    [3.1, {}, [], READY.METADATA],
    [3.25, {}, ["stalled"], READY.METADATA],
    [9, {}, [], READY.METADATA],
    [9.1, { receivedBytes: 3, ...shows }, ["progress", "loadeddata"], READY.CURRENT],
    [9.2, { endFrame: 2, waiting: false }, ["canplay"], READY.FUTURE],
    [9.3, { endFrame: 19 }, [], READY.FUTURE],
    [9.4, { endFrame: 20 }, ["canplaythrough"], READY.ENOUGH],
    [9.59, {}, [], READY.ENOUGH],
    [9.6, {}, ["progress", "suspend"], READY.ENOUGH],
    [9.7, { playing: true, waiting: true }, ["timeupdate", "waiting"], READY.CURRENT],
    [9.8, { waiting: false }, ["canplay", "playing", "canplaythrough"], READY.ENOUGH],
    [9.9, { isSeeking: true }, ["timeupdate", "waiting"], READY.METADATA],
    [10, { isSeeking: false, ...atEnd }, ["canplay", "playing", "canplaythrough"], READY.ENOUGH],
    [11, { live: true }, ["timeupdate", "waiting"], READY.CURRENT],
  ];
  let state = LOADING;
  for (const [nowS, changes, events, ready] of steps) {
    state = { ...state, ...changes };
    assert.deepEqual(readiness.update(state, nowS), events, `at ${nowS} s`);
    assert.equal(readiness.ready, ready, `at ${nowS} s`);
  }
  readiness.reset();
  assert.deepEqual([readiness.ready, readiness.network], [READY.NOTHING, NETWORK.EMPTY]);
});

test("ranges of frames join where they touch", () => {
  const ranges = new FrameRanges();
  for (const range of ["10-20", "30-40", "5-5", "40-45", "0-9", "20-25"])
    ranges.add(...range.split("-").map(Number));
  assert.equal(ranges.ranges.join(" "), "0,9 10,25 30,45");
  ranges.add(9, 31);
  assert.deepEqual(ranges.ranges, [[0, 45]]);
  const inSeconds = ranges.inSeconds(30);
  assert.deepEqual([inSeconds.length, inSeconds.start(0), inSeconds.end(0)], [1, 0, 1.5]);
  assert.throws(() => inSeconds.end(1), { name: "IndexSizeError" });
});

test("times as text", () => {
  const texts = [0, 67, 3607, -1].map((seconds) => timeText(seconds));
  assert.deepEqual(texts, ["0:00", "1:07", "1:00:07", "0:00"]);
  assert.equal(timeText(7.3 - 1e-9, true), "0:07.3");
  assert.equal(frameTimeText(30, 120, 30, true), "-0:02");
  assert.equal(positionText(0, 300, 30, false), "0:00 / 0:10");
  assert.equal(positionText(15, 60, 30, false), "0:00.5 / 0:02.0");
  assert.equal(positionText(59, 60, 30, false), "0:02.0 / 0:02.0", "the last frame is the end");
  assert.equal(positionText(59, 60, 30, true), "-0:00");
});

test("two taps of one finger, soon and near to each other", () => {
  const doubles = (...touches) => {
    const taps = new Taps();
    return touches.map(([fromMs, toMs, clientX, clientY, numFingers]) => {
      taps.down({ clientX, clientY, timeStamp: fromMs }, numFingers);
      return taps.up({ clientX, clientY, timeStamp: toMs });
    });
  };
  const first = [0, 80, 100, 100, 1];
  const three = doubles(first, [250, 330, 110, 95, 1], [500, 580, 110, 95, 1]);
  assert.deepEqual(three, [false, true, false]);
  for (const other of [
    [250, 330, 200, 100, 1], // elsewhere
    [900, 980, 100, 100, 1], // too late
    [250, 900, 100, 100, 1], // a long press
    [250, 330, 110, 95, 2], // the second of two fingers
  ])
    assert.deepEqual(doubles(first, other), [false, false]);
});
