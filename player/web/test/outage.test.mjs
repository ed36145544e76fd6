/** Hosts that are gone, silent, or answer with the same error again and again: what is asked, and how long. */
import assert from "node:assert/strict";
import { test } from "node:test";

import { Fetcher } from "../source/fetcher.js";
// What sources import meanwhile is there at once: only the host takes time.
import "../source/hosted.js";
import "../source/refusal.js";
import "../source/served.js";
import { openSource } from "../source/source.js";
import { manifestBytes, playRecord, settled, startRecord } from "./support.mjs";
import { VirtualHost } from "./virtualhost.mjs";

const START = startRecord(manifestBytes());
const SERVED = "http://host/watch/clip/";
const PLAY = "v1/streams/clip/play";

function fetching() {
  const troubles = [];
  return { troubles, fetcher: new Fetcher({ onTrouble: (message) => troubles.push(message) }) };
}

/** Waits in virtual time until a promise is settled; gives the message of its error, and when it came. */
async function failureOf(host, promise) {
  let failure = null;
  promise.then(
    () => (failure = { message: null }),
    ({ message }) => (failure = { message, atS: host.nowMs / 1000 }),
  );
  await host.untilAsked(() => failure !== null);
  await host.until(() => failure !== null, 200);
  return failure;
}

/** A body that sends `first`, and then nothing. */
const stuck = (first) =>
  new ReadableStream({ start: (controller) => first && controller.enqueue(first) });

test("while the network is gone, all requests together send one at a time", async (context) => {
  let isThere = true;
  const answer = () => (isThere ? new Response("bytes") : Promise.reject(new TypeError("refused")));
  const host = new VirtualHost(context, answer, () => 0.02);
  const { fetcher, troubles } = fetching();
  await failureOf(host, fetcher.get("http://host/first", 10));
  isThere = false;
  host.asked.length = 0;
  let come = 0;
  for (let n = 0; n < 8; n++) fetcher.get(`http://host/${n}`, 10).then(() => come++);
  const endMs = host.nowMs + 12_000;
  await host.until(() => host.nowMs >= endMs);
  assert.ok(host.asked.length >= 8 + 10 && host.asked.length <= 8 + 24, `${host.asked.length}`);
  assert.ok(host.waiting.size <= 1 && troubles.every((one) => /network is gone/.test(one)));
  isThere = true;
  const backMs = host.nowMs;
  await host.until(() => come === 8);
  assert.ok(host.nowMs - backMs <= 2100, "none waits longer than its own delay and a try's");
});

test("a request that its caller gives up leaves the turn to the next one", async (context) => {
  let isThere = false;
  const answer = () => (isThere ? new Response("bytes") : Promise.reject(new TypeError("refused")));
  const host = new VirtualHost(context, answer, (path) => (isThere && path === "0" ? 9 : 0.02));
  const { fetcher, troubles } = fetching();
  const abort = new AbortController();
  const given = fetcher.get("http://host/0", 10, undefined, { signal: abort.signal });
  const other = fetcher.get("http://host/1", 10);
  given.catch(() => {});
  // A request that is under way then would be answered at once.
  await host.until(() => host.asked.length > 6 && host.waiting.size === 0);
  isThere = true;
  await host.until(() => [...host.waiting].some(({ dueMs }) => dueMs > host.nowMs + 1000));
  abort.abort();
  assert.equal((await failureOf(host, other)).message, null);
  assert.equal(troubles.at(-1), null);
});

for (const [what, answer, delayS] of [
  ["never answers", null, () => Infinity],
  ["sends a head and nothing else", () => new Response(stuck(null)), () => 0.02],
  ["sends a byte and nothing else", () => new Response(stuck(Uint8Array.of(1))), () => 0.02],
]) {
  test(`a host that ${what} is given up after a minute`, async (context) => {
    const host = new VirtualHost(context, answer, delayS);
    const { fetcher, troubles } = fetching();
    const { message, atS } = await failureOf(host, fetcher.get("http://host/file", 10));
    assert.match(message, /cannot be reached; check the network and try again/);
    assert.ok(atS > 60 && atS <= 78, `${atS} s`);
    assert.deepEqual(new Set(troubles), new Set(["The host does not answer; trying again"]));
    assert.ok(host.asked.length <= 6, "each try waits for a while");
  });
}

test("what trickles is waited for, and what waits beside it", async (context) => {
  const bytes = new Uint8Array(1);
  const body = new ReadableStream({
    async pull(controller) {
      for (let n = 0; n < 9; n++) {
        await new Promise((resolve) => setTimeout(resolve, 10_000));
        controller.enqueue(bytes);
      }
      controller.close();
    },
  });
  const delayS = (path) => (path === "queued" ? 95 : 0.02);
  const host = new VirtualHost(
    context,
    (path) => new Response(path === "slow" ? body : "-"),
    delayS,
  );
  const { fetcher, troubles } = fetching();
  const queued = fetcher.get("http://host/queued", 10);
  assert.equal((await failureOf(host, fetcher.get("http://host/slow", 10))).message, null);
  assert.equal((await failureOf(host, queued)).message, null);
  assert.deepEqual([troubles, host.asked], [[], ["queued", "slow"]]);
});

for (const [what, first] of [
  ["never answers", null],
  ["falls silent in a play", START],
]) {
  test(`a server that ${what} is given up`, async (context) => {
    const isAsked = (path) => path === PLAY && first !== null;
    let plays = 0;
    const answer = () => new Response(stuck(first), { headers: { "Swings-Play": "a" } });
    const delayS = (path) => (isAsked(path) && plays++ === 0 ? 0.02 : Infinity);
    const host = new VirtualHost(context, answer, delayS);
    const { fetcher, troubles } = fetching();
    const opening = openSource(SERVED, fetcher);
    let failure;
    let atS;
    if (first === null) ({ message: failure, atS } = await failureOf(host, opening));
    else {
      await host.untilAsked();
      await host.until(() => host.asked.length > 0 && host.waiting.size === 0);
      const play = (await opening).play({
        firstFrame: 0,
        mostLayers: 3,
        nowS: () => host.nowMs / 1000,
      });
      const isOver = () => {
        play.reportPosition(0, false, 1);
        return play.failure !== null;
      };
      await host.until(isOver, 200);
      [failure, atS] = [play.failure.message, host.nowMs / 1000];
      play.close();
    }
    assert.equal(failure, "http://host/v1/streams/clip/: The host does not answer");
    assert.ok(atS > 60 && atS <= 95, `${atS} s`);
    const said = new Set(troubles.filter((one) => one !== null));
    assert.deepEqual(said, new Set(["The host does not answer; trying again"]));
    assert.ok(host.waiting.size <= 1);
  });
}

test("a server that reports the same error three times in a row is believed", async (context) => {
  const body = () =>
    Buffer.concat([START, playRecord({ kind: "error", message: "this is broken" })]);
  const headers = { "Swings-Play": "a" };
  const host = new VirtualHost(
    context,
    () => new Response(body(), { headers }),
    () => 0.02,
  );
  const { fetcher } = fetching();
  const opening = openSource(SERVED, fetcher);
  await host.untilAsked();
  await host.until(() => host.asked.length > 0 && host.waiting.size === 0);
  const play = (await opening).play({
    firstFrame: 0,
    mostLayers: 3,
    nowS: () => host.nowMs / 1000,
  });
  await host.until(() => play.failure !== null);
  assert.match(play.failure.message, /The server reports: this is broken$/);
  assert.equal(host.asked.filter((path) => path === PLAY).length, 3);
});

test("an address that leads to itself is asked a few times", async (context) => {
  const asked = [];
  const refused = () => Promise.reject(new TypeError("too many redirects"));
  const host = new VirtualHost(context, refused, () => 0.02);
  const { fetch } = globalThis;
  context.mock.method(globalThis, "fetch", (url, init) => {
    asked.push([init.method, init.mode, init.redirect]);
    return init.redirect === "manual"
      ? Promise.resolve({ type: "opaqueredirect" })
      : fetch(url, init);
  });
  const { message } = await failureOf(host, fetching().fetcher.get("http://host/file", 10));
  assert.match(message, /leads to an address that cannot be reached, or back to itself$/);
  assert.equal(asked.length, 6);
  await settled();
});
