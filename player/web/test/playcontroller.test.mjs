/** Stills and loops: what a player asks its host for, round after round. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { readManifest } from "../format/manifest.js";
import { readIndex } from "../format/objects.js";
import { PlayController } from "../playback/playcontroller.js";
import { Fetcher } from "../source/fetcher.js";
import { HostedStream } from "../source/hosted.js";
import { filesOf, HOLES } from "./support.mjs";
import { VirtualHost } from "./virtualhost.mjs";

/** Three layers, three segments of five frames, 0.6 s. */
const FILES = filesOf("far");
const MANIFEST = readManifest(FILES["manifest.json"]);
const RECORDS = readIndex(FILES["index.bin"], MANIFEST);
const NUM_FRAMES = RECORDS.reduce((sum, { numFrames }) => sum + numFrames, 0);

const answered = (path) => new Response(FILES[path]);

/** A player of `records`, whose host answers after `delayS`. */
function playing(context, records, delayS, start = {}, answer = answered) {
  const host = new VirtualHost(context, answer, delayS);
  const fetcher = new Fetcher();
  const stream = new HostedStream("http://host/", fetcher, MANIFEST, false);
  stream.index.records = records;
  const posted = [];
  const shown = [];
  const failures = [];
  const outlet = {
    post: (message) => posted.push(message),
    show: ({ frame }) => shown.push(frame),
    fail: (error) => failures.push(error),
  };
  const player = new PlayController(stream, fetcher, outlet, start);
  context.after(() => player.close());
  context.mock.method(console, "warn", () => {});
  player.setPlaying(true);
  const until = (isOver) => host.until(() => failures.length > 0 || isOver());
  const ended = () => posted.filter(({ kind }) => kind === "ended").length;
  return { player, host, posted, shown, failures, until, ended };
}

const isUpper = (path) => /[1-9]$/.test(path);

for (const loop of [false, true]) {
  test(`one frame shows and stays, ${loop ? "as in" : "without"} a loop`, async (context) => {
    const records = [{ ...RECORDS[0], numFrames: 1 }];
    const delayS = (path) => (isUpper(path) ? 0.5 : 0.1);
    const { player, host, until, ended } = playing(context, records, delayS, { loop });
    await until(() => player.playback.play.layers === 3);
    const beganMs = host.nowMs;
    await until(() => host.nowMs >= beganMs + 3000);
    assert.ok(host.asked.length <= 20);
    assert.deepEqual(host.asked.sort(), [...new Set(host.asked)].sort(), "each once");
    assert.deepEqual(host.aborted, []);
    assert.deepEqual([ended(), player.playing], loop ? [0, true] : [1, false]);
    assert.deepEqual([player.playback.frame, player.playback.waiting], [0, false]);
    if (loop) player.loop = false;
    else player.setPlaying(true);
    await until(() => ended() === (loop ? 1 : 2));
    assert.equal(host.asked.length, new Set(host.asked).size, "played again from what is here");
  });
}

test("layers that take longer to come than a round are waited for over rounds", async (context) => {
  const delayS = (path) => (isUpper(path) ? 1.7 : 0.02);
  const { player, host, shown, until, ended } = playing(context, RECORDS, delayS, { loop: true });
  const first = player.round;
  await until(() => player.playback.play.layers === 3 && player.playback.frame > 9);
  assert.ok(player.round !== first && shown.filter((frame) => frame === 0).length > 2);
  await until(() => host.nowMs >= 9000);
  assert.deepEqual(host.aborted, []);
  assert.equal(host.asked.length, new Set(host.asked).size, "each once");
  assert.deepEqual([ended(), player.playback.stalls], [0, 0]);
});

const damaged = {
  missing: () => new Response("gone", { status: 404 }),
  cut: (bytes) => new Response(bytes.slice(0, -3)),
  flipped: (bytes) =>
    new Response(bytes.map((one, at) => (at === bytes.length - 9 ? one ^ 1 : one))),
};

for (const { part, fault, layers } of HOLES) {
  test(`${part} ${fault}: ${layers ?? "the play ends"}`, async (context) => {
    const answer = (path) =>
      path === `segments/${part}` ? damaged[fault](FILES[path]) : answered(path);
    const { player, host, shown, failures, until, ended } = playing(
      ...[context, RECORDS, () => 0.02, {}, answer],
    );
    const found = [3, 3, 3];
    const note = () => {
      const { frame, play } = player.playback;
      const segment = Math.floor(frame / MANIFEST.segmentFrames);
      // With the first picture not all objects are under way yet.
      if (frame > 2) found[segment] = Math.min(found[segment], play.layers);
      return ended() > 0;
    };
    await until(note);
    if (layers === null) {
      assert.match(String(failures), /^(Source|Format)Error/);
      const whole = MANIFEST.segmentFrames * parseInt(part, 10);
      assert.deepEqual(
        shown.slice(0, whole),
        [...Array(whole).keys()],
        "what came is played first",
      );
    } else {
      assert.deepEqual(failures, []);
      assert.deepEqual([found, shown], [layers, [...Array(NUM_FRAMES).keys()]]);
      assert.equal(host.asked.filter((path) => path === `segments/${part}`).length, 1);
    }
  });
}

test("a seek goes past what is missing, while what is before it plays", async (context) => {
  const answer = (path) => (path === "segments/1/0" ? damaged.missing() : answered(path));
  const { player, shown, failures, until, ended } = playing(
    ...[context, RECORDS, () => 0.02, {}, answer],
  );
  await until(() => player.round.source.failure !== null && shown.length > 0);
  player.seek(2 * MANIFEST.segmentFrames, 1);
  await until(() => ended() > 0);
  assert.deepEqual([failures, shown.at(-1)], [[], NUM_FRAMES - 1]);
});

test("that a link is too thin is said once, with both rates", async (context) => {
  const delayS = (path) => (/[12].0$/.test(path) ? 2 : 0.02);
  const start = { mostLayers: 1 };
  const { player, host, posted, until, ended } = playing(...[context, RECORDS, delayS, start]);
  player.stream.estimator = { rateBps: 400, add() {} };
  for (let round = 1; round <= 2; round++) {
    await until(() => player.playback.frame > 0 && !player.playback.hasEnded);
    // It has stalled before.
    Object.assign(player.playback, { leadS: 1, resumedS: host.nowMs / 1000 });
    await until(() => ended() === round);
    player.stream.cache.segments.delete(1);
    player.setPlaying(true);
  }
  const said = posted.filter(({ kind }) => kind === "trouble").map(({ message }) => message);
  const first = "This connection carries 0.0004 of the 0.02 Mbit/s that this video needs";
  assert.deepEqual(said, [first, null]);
  assert.equal(player.playback.stalls, 2);
});

test("a stream that was replaced is named, whatever its bytes look like", async (context) => {
  const other = filesOf("leases");
  let files = FILES;
  const answer = (path) => new Response(files[path] ?? "", { status: path in files ? 200 : 404 });
  const { player, failures, until } = playing(context, RECORDS, () => 0.1, {}, answer);
  await until(() => player.playback.frame === 4);
  player.stream.cache.segments.clear();
  files = other;
  player.seek(0, 1);
  await until(() => false);
  assert.deepEqual(failures.map(String), ["SourceError: This video was replaced"]);
});

test("scrubbing that ends and begins during a request shows the picture of the new place", async (context) => {
  const { player, host, shown, until } = playing(context, RECORDS, () => 0.3);
  player.setPlaying(false);
  await until(() => shown.length > 0);
  player.stream.cache.segments.clear();
  shown.length = 0;
  await player.scrub(9);
  await until(() => host.waiting.size > 0);
  player.scrubber.end();
  player.scrub(9);
  await until(() => shown.length > 0);
  assert.deepEqual(shown, [10]);
});
