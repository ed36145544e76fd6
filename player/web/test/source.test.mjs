/** What is fetched of a stream's host, and what is done where that fails. */
import assert from "node:assert/strict";
import { test } from "node:test";

import { Fetcher, SourceError } from "../source/fetcher.js";
import { fileUrl, folderUrl } from "../source/addresses.js";
import { fetchRange, fileBytes, objectUrl } from "../source/files.js";
import { follow, GrowingIndex } from "../source/hosted.js";
import { edgeFrame, followPeriodS, isBehind } from "../source/liveedge.js";
import { openPlay } from "../source/playresponse.js";
import { FormatError } from "../format/bytes.js";
import { skipMapsOf } from "../format/manifest.js";
import { PackedStream } from "../source/packed.js";
import { ServedStream } from "../source/served.js";
import { openSource } from "../source/source.js";
import {
  answering,
  filesOf,
  joined,
  manifestBytes,
  manifestOf,
  recordOf,
  settled,
  startRecord,
} from "./support.mjs";

const BASE = "http://host:8000/away/";

test("an object of another origin is refused unless it is allowed", () => {
  const away = "http://other:8000/stream/0/0";
  assert.throws(
    () => objectUrl(BASE, away, false),
    new SourceError(
      `${BASE}manifest.json leads to another host, http://other:8000; other-hosts, as an attribute of ` +
        "the player or other-hosts=1 in the address of its page, allows it",
    ),
  );
  assert.equal(objectUrl(BASE, away, true), away);
  const here = ["http://host:8001/", "\\\\host:1/", "https://host:8000/", "//host/"];
  for (const origin of [...here, "//elsewhere.example/", "http://host0.example/"])
    assert.throws(() => objectUrl(BASE, `${origin}0/0`, false), /leads to another host/, origin);
  for (const path of ["http://host:8000/stream/0/0", "/stream/0/0", "../stream/0/0"])
    assert.equal(objectUrl(BASE, path, false), "http://host:8000/stream/0/0");
  for (const isAllowed of [false, true]) {
    const refused = (path, message) =>
      assert.throws(() => objectUrl(BASE, path, isAllowed), { name: "FormatError", message });
    refused("http://[0", /is not a URL/);
    refused("data:text/plain,0", /is not on the web/);
    refused("file:///etc/0", /is not on the web/);
  }
});

test("the query of a stream's address goes with every file of its host, and its cookies if wanted", async (context) => {
  const page = "http://page/shows/";
  for (const [src, url] of [
    ["clip", `${page}clip/`],
    ["clip/", `${page}clip/`],
    ["/clip?token=a%2Fb#part", "http://page/clip/?token=a%2Fb"],
    ["clip.swings?token=a", `${page}clip.swings?token=a`],
    ["http://host/watch/clip?t=3", "http://host/watch/clip/?t=3"],
  ])
    assert.equal(folderUrl(src, page), url);
  const base = folderUrl("http://host/clip?token=a", page);
  assert.equal(fileUrl("poster.jpg?b", base), "http://host/clip/poster.jpg?b");
  assert.equal(objectUrl(base, "http://other/0/0", true), "http://other/0/0");
  const files = filesOf("one-lane");
  const asked = [];
  answering(context, (url, { credentials }) => {
    asked.push([url, credentials]);
    return new Response(files[new URL(url).pathname.replace("/clip/", "")]);
  });
  const stream = await openSource(base, new Fetcher({ credentials: "include" }));
  await stream.object(stream.records[0], 0, () => {});
  await fileBytes(stream.fetcher, base, "manifest.json", null, 1e6);
  const paths = ["manifest.json", "index.bin", "segments/0/0", "manifest.json"];
  assert.deepEqual(
    asked,
    paths.map((path) => [`http://host/clip/${path}?token=a`, "include"]),
  );
});

test("what the manifest's address decides, the fetched stream obeys", async (context) => {
  const files = filesOf("one-lane");
  const described = JSON.parse(Buffer.from(files["manifest.json"]).toString());
  const template = "http://other/{segment}/{layer}";
  const led = JSON.stringify({ ...described, object_url: template });
  answering(context, (url) => {
    if (url === "http://other/0/0") return new Response(files["segments/0/0"]);
    return new Response(url.endsWith(".json") ? led : files["index.bin"]);
  });
  for (const isAllowed of [false, true]) {
    const stream = await openSource(BASE, new Fetcher(), null, isAllowed);
    let numBytes = 0;
    const fetched = stream.object(stream.records[0], 0, (n) => (numBytes += n));
    if (!isAllowed) await assert.rejects(fetched, /leads to another host/);
    else assert.ok((await fetched).size > 0 && numBytes === files["segments/0/0"].length);
  }
});

const NUM_GAUSSIANS = 2 ** 24;
const MANY = { slots: [2 ** 20], swin_size: 16, num_gs: NUM_GAUSSIANS, segment_frames: 1 };

for (const url of ["http://host/many/", "http://host/watch/many/"]) {
  test(`2^24 Gaussians at ${url} cost nothing before they are allowed`, async (context) => {
    const manifest = manifestBytes(MANY);
    answering(context, (asked) => {
      if (asked.endsWith("manifest.json")) return new Response(manifest);
      if (asked.endsWith("index.bin")) return new Response(recordOf(manifestOf(MANY), 0));
      assert.ok(asked.startsWith("http://host/v1/streams/many/play?"), asked);
      return new Response(startRecord(manifest), { headers: { "Swings-Play": "a" } });
    });
    const message =
      /has 16,777,216 Gaussians; max-gaussians=16777216, .* \(about 4\.7 GB of memory\)/;
    for (const most of [null, NUM_GAUSSIANS - 1])
      await assert.rejects(openSource(url, new Fetcher(), most), { kind: "unsupported", message });
    const before = process.memoryUsage();
    const stream = await openSource(url, new Fetcher(), NUM_GAUSSIANS);
    const after = process.memoryUsage();
    assert.equal(stream.manifest.numGs, NUM_GAUSSIANS);
    assert.ok(after.arrayBuffers - before.arrayBuffers < NUM_GAUSSIANS);
    assert.ok(after.heapTotal - before.heapTotal < 2 * NUM_GAUSSIANS);
    if ("first" in stream) stream.first.close();
  });
}

test("a server whose stream is another one by now is noticed by its manifest", async (context) => {
  let manifest = { live: true };
  answering(context, () => {
    const start = (controller) => controller.enqueue(startRecord(manifestBytes(manifest)));
    return new Response(new ReadableStream({ start }));
  });
  const stream = await openSource("http://host/watch/clip/", new Fetcher());
  stream.first.close();
  const failures = [];
  for (const [firstFrame, changes] of [{ live: false }, { title: "another one" }].entries()) {
    manifest = changes;
    const play = stream.play({ firstFrame: firstFrame + 1, mostLayers: 3, nowS: () => 0 });
    await settled();
    failures.push(String(play.failure));
    play.close();
  }
  assert.deepEqual(failures, ["null", "SourceError: This video was replaced"]);
});

const MANIFEST = manifestOf();
const row = (segment) => recordOf(MANIFEST, segment);

for (const hasRanges of [true, false]) {
  test(`the index grows on a host ${hasRanges ? "with" : "without"} ranges`, async (context) => {
    let bytes = new Uint8Array(0);
    answering(context, (_, { headers }) => {
      const first = /^bytes=(\d+)-$/.exec(headers?.Range ?? "")?.[1];
      const isRange = hasRanges && first !== undefined;
      const sent = isRange ? bytes.slice(Number(first)) : bytes;
      return new Response(sent, { status: isRange ? 206 : 200 });
    });
    const index = new GrowingIndex("http://host/index.bin", new Fetcher(), MANIFEST);
    let known = 0;
    for (const count of [0, 1, 0, 2, 1, 0, 5]) {
      const rows = Array.from({ length: known + count }, (_, segment) => row(segment));
      bytes = joined(rows);
      const beforeBytes = index.fetcher.receivedBytes;
      const fresh = await index.refresh();
      const sent = hasRanges && known > 1 ? count + 1 : known + count;
      assert.equal(index.fetcher.receivedBytes - beforeBytes, sent * row(0).length);
      assert.equal(
        String(fresh.map(({ segment }) => segment)),
        String([...rows.keys()].slice(known)),
      );
      known += count;
      assert.equal(index.records.length, known);
    }
    const good = bytes;
    const others = Array.from({ length: known }, (_, segment) => recordOf(MANIFEST, segment, 2));
    for (const bad of [good.slice(0, 3 * row(0).length), new Uint8Array(0), joined(others)]) {
      bytes = bad;
      await assert.rejects(index.refresh(), /This video was replaced/);
      assert.equal(index.records.length, known, "what is known stays");
    }
    bytes = joined([good, row(known).slice(0, 100)]);
    assert.deepEqual(await index.refresh(), [], "a record that is being written");
  });
}

test("a packed stream that is another file by now is named as such", async (context) => {
  const reply = { status: 206, headers: { "Content-Range": "bytes 0-2/98" } };
  answering(context, () => new Response("abc", reply));
  const layout = { manifest: MANIFEST, records: [], object: () => ({ first: 0, size: 3 }) };
  const stream = new PackedStream("http://host/clip.swings", new Fetcher(), layout, 99);
  await assert.rejects(stream.objectBytes(null, 0, assert.ok), /^SourceError: This video was/);
});

test("a packed stream that is another file of the same size is named as such", async (context) => {
  const records = [1, 2].map((n) => ({ objectSha256: [Uint8Array.of(n)] }));
  const layout = { manifest: MANIFEST, records };
  const stream = new PackedStream("http://host/clip.swings", new Fetcher(), layout, 99);
  const why = new FormatError("of the object");
  const found = [];
  for (const now of [
    records,
    [...records].reverse(),
    new FormatError("no head"),
    new Error("gone"),
  ]) {
    context.mock.method(PackedStream, "open", async () => {
      if (now instanceof Error) throw now;
      return { layout: { records: now } };
    });
    found.push((await stream.explain(why)) === why ? "as it was" : "replaced");
  }
  assert.deepEqual(found, ["as it was", "replaced", "replaced", "as it was"]);
});

test("a live stream is looked for once a segment, and less often while it is paused", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const stream = { manifest: { live: true, fps: 30, segmentFrames: 15 }, isPaused: false };
  let looks = 0;
  stream.refresh = async () => (looks++, false);
  follow(stream, assert.fail);
  const inTenSeconds = async () => {
    looks = 0;
    for (let n = 0; n < 20; n++) {
      context.mock.timers.tick(500);
      await settled();
    }
    return looks;
  };
  assert.equal(await inTenSeconds(), 20);
  stream.isPaused = true;
  assert.equal(await inTenSeconds(), 4);
  stream.isPaused = false;
  assert.equal(await inTenSeconds(), 20);
});

test("the edge is a segment behind what comes while one waits", () => {
  for (const lengths of ["15 30", "1 30", "50 25", "200 10"]) {
    const [segmentFrames, fps] = lengths.split(" ").map(Number);
    const shape = { fps, segmentFrames };
    const periodS = followPeriodS(shape);
    assert.equal(periodS, Math.min(5, Math.max(0.5, segmentFrames / fps)));
    // A segment exists once it is complete, is found up to a period later, and then fetched.
    const neededFrames = segmentFrames + fps * periodS;
    let last = 0;
    for (let numFrames = 1; numFrames < 12 * segmentFrames + 8 * fps; numFrames++) {
      const edge = edgeFrame(shape, numFrames);
      assert.ok(edge >= last && edge % segmentFrames === 0);
      const lag = numFrames - edge;
      assert.ok(edge === 0 || lag > neededFrames);
      assert.ok(lag <= neededFrames + fps / 2 + segmentFrames);
      assert.equal(isBehind(shape, numFrames, edge - 3 * fps - 1), true);
      assert.equal(isBehind(shape, numFrames, edge - 3 * fps), false);
      last = edge;
    }
  }
});

/** Longer timers are for silent hosts, of which these tests have none. */
const LONGEST_DELAY_MS = 1000;

/**
 * A fetcher whose waits between tries are over at once, on a clock that goes on by `waitS` in each; and
 * what it says of its trouble.
 */
function trying(context, giveUpS = 60, waitS = 1) {
  let nowMs = 0;
  context.mock.method(performance, "now", () => nowMs);
  const waitsMs = [];
  context.mock.method(globalThis, "setTimeout", (run, ms) => {
    if (ms === 0) return queueMicrotask(run); // the gate opens
    if (ms > LONGEST_DELAY_MS) return;
    waitsMs.push(ms);
    nowMs += 1000 * waitS;
    queueMicrotask(run);
  });
  const troubles = [];
  const fetcher = new Fetcher({ giveUpS, onTrouble: (message) => troubles.push(message) });
  return { fetcher, troubles, waitsMs };
}

const URL_ = "http://host/file";
const GONE = "The network is gone; trying again";

test("a host that fails for a while is asked again, less and less often", async (context) => {
  const { fetcher, troubles, waitsMs } = trying(context);
  let tries = 0;
  answering(context, () => {
    tries += 1;
    if (tries < 3) throw new TypeError("no network");
    return new Response("bytes", { status: tries < 6 ? 503 : 200 });
  });
  assert.equal(Buffer.from(await fetcher.get(URL_, 10)).toString(), "bytes");
  assert.deepEqual(troubles, [GONE, GONE, GONE, GONE, GONE, null]);
  for (const [n, mostMs] of [250, 500, 1000, 1000, 1000].entries())
    assert.ok(waitsMs[n] >= mostMs / 2 && waitsMs[n] <= mostMs);
});

test("a host is given up after a minute without success", async (context) => {
  const { fetcher, waitsMs } = trying(context, 60, 10);
  answering(context, () => new Response("", { status: 500 }));
  await assert.rejects(fetcher.get(URL_, 10), /cannot be reached; check the network and try again/);
  assert.equal(waitsMs.length, 7);
});

test("a host that answers other pages only is told from a network that is gone", async (context) => {
  const { fetcher, troubles } = trying(context, 2);
  const modes = [];
  let isThere = true;
  answering(context, (_, { method = "GET", mode }) => {
    modes.push([method, mode]);
    if (method === "GET" || !isThere) throw new TypeError("refused");
    return new Response();
  });
  await assert.rejects(
    fetcher.get(URL_, 10),
    /^SourceError: http:.*host answers, but does not let/,
  );
  const get = ["GET", undefined];
  assert.deepEqual(modes, [get, get, get, ["HEAD", "no-cors"], get]);
  assert.deepEqual(troubles, [GONE, GONE]);
  isThere = false;
  await assert.rejects(fetcher.get(URL_, 10), /cannot be reached/);
  modes.length = 0;
  fetcher.receivedBytes = 1;
  await assert.rejects(fetcher.get(URL_, 10), /cannot be reached/);
  assert.ok(!String(modes).includes("HEAD"), "it has answered this page before");
});

test("a network that returns when the host is looked for is no refusal", async (context) => {
  const { fetcher } = trying(context);
  let isThere = false;
  answering(context, (_, { method = "GET" }) => {
    if (method === "HEAD") isThere = true;
    else if (!isThere) throw new TypeError("no network");
    return new Response("bytes");
  });
  assert.equal((await fetcher.get(URL_, 10)).length, 5);
});

/** A response whose body has more than is read, and which notes that it was ended. */
function endless(status, cancelled, headers = {}) {
  const pull = (controller) => controller.enqueue(new Uint8Array(1000));
  const body = new ReadableStream({ pull, cancel: () => cancelled.push(status) });
  return new Response(body, { status, headers });
}

test("what a refusing host goes on sending is ended", async (context) => {
  const { fetcher } = trying(context, 0);
  const cancelled = [];
  let status = 404;
  answering(context, () => endless(status, cancelled, { "Content-Range": "bytes 4-6/99" }));
  const place = { first: 5, size: 3 };
  const cases = [
    [404, () => fetcher.get(URL_, 10), /HTTP 404/],
    [200, () => fetchRange(fetcher, URL_, place), /does not send parts/],
    [206, () => fetchRange(fetcher, URL_, place), /another part/],
    [500, () => fetcher.get(URL_, 10), /cannot be reached/],
    [403, () => openPlay(fetcher, BASE, { fromFrame: 0 }), /HTTP 403/],
    [503, () => openPlay(fetcher, BASE, { fromFrame: 0 }), /busy/],
  ];
  for (const [answer, ask, why] of cases) {
    cancelled.length = 0;
    status = answer;
    await assert.rejects(async () => {
      for (;;) await ask();
    }, why);
    assert.ok(cancelled.length > 0 && cancelled.every((one) => one === answer), `${answer}`);
  }
});

test("a minute without success begins with the last byte that was new", async (context) => {
  const { fetcher, waitsMs } = trying(context, 1);
  let nowMs = 0;
  context.mock.method(performance, "now", () => nowMs);
  answering(context, () => {
    let pulls = 0;
    const pull = (controller) => {
      nowMs += 700;
      if (pulls++ < 2) controller.enqueue(new Uint8Array(3));
      else controller.error(new TypeError("broken"));
    };
    return new Response(new ReadableStream({ pull }));
  });
  await assert.rejects(fetcher.get(URL_, 10), /cannot be reached/);
  assert.equal(waitsMs.length, 1, "once more after what had gone well for longer than a second");
});

test("what is refused, too long or no address of the web is not asked for twice", async (context) => {
  const { fetcher, waitsMs } = trying(context);
  answering(context, (url) => new Response("12345", { status: url.endsWith("no") ? 404 : 200 }));
  await assert.rejects(fetcher.get(`${URL_}/no`, 10), new SourceError(`${URL_}/no: HTTP 404`));
  await assert.rejects(fetcher.get(URL_, 4), /has more than 4 bytes; this is not a stream/);
  await assert.rejects(fetcher.get("file:///etc/passwd", 10), /play it from a web server/);
  assert.equal((await fetcher.get(URL_, 5)).length, 5);
  const ended = AbortSignal.abort(new Error("over"));
  await assert.rejects(fetcher.get(URL_, 9, undefined, { signal: ended }), ended.reason);
  assert.deepEqual(waitsMs, []);
});

test("the bytes of a try that broke off do not count", async (context) => {
  const { fetcher } = trying(context);
  let tries = 0;
  answering(context, () => {
    const isGood = ++tries === 2;
    let pulls = 0;
    const pull = (controller) => {
      if (pulls++ === 0) controller.enqueue(new Uint8Array(3));
      else if (isGood) controller.close();
      else controller.error(new TypeError("broken"));
    };
    return new Response(new ReadableStream({ pull }));
  });
  const counts = [];
  assert.equal((await fetcher.get(URL_, 10, (numBytes) => counts.push(numBytes))).length, 3);
  assert.deepEqual(counts, [3, -3, 3]);
  assert.equal(fetcher.receivedBytes, 6, "they have crossed the network");
});

test("a part of a file is what was asked for, and tells the size of the file", async (context) => {
  const { fetcher } = trying(context);
  let reply = { status: 206, headers: { "Content-Range": "bytes 5-7/99" } };
  const calls = answering(context, () => new Response("abc", reply));
  const range = () => fetchRange(fetcher, URL_, { first: 5, size: 3 });
  assert.deepEqual(await range(), { bytes: Uint8Array.from(Buffer.from("abc")), fileBytes: 99 });
  const init = calls.mock.calls[0].arguments[1];
  assert.deepEqual([init.headers, init.cache], [{ Range: "bytes=5-7" }, "no-store"]);
  reply = { status: 206 };
  assert.equal((await range()).fileBytes, null, "a host of another origin hides it");
  reply = { status: 206, headers: { "Content-Range": "bytes 4-6/99" } };
  await assert.rejects(range(), /sent another part than requested/);
  reply = { status: 200 };
  await assert.rejects(range(), /does not send parts of a file/);
});

test("bytes from the browser's cache say nothing of the link", async (context) => {
  let report;
  const { PerformanceObserver } = globalThis; // which Node makes when it is first read
  context.after(() => (globalThis.PerformanceObserver = PerformanceObserver));
  globalThis.PerformanceObserver = function (callback) {
    report = (entries) => callback({ getEntries: () => entries });
    this.observe = () => {};
  };
  const files = filesOf("one-lane");
  answering(context, (url) => new Response(files[url.slice(BASE.length)]));
  const { estimator } = await openSource(BASE, new Fetcher());
  estimator.add(1e6, 0.01);
  const fromCache = [0, 300].map((transferSize) => ({ transferSize, encodedBodySize: 5e5 }));
  report([...fromCache, { transferSize: 5300, encodedBodySize: 5000 }]);
  assert.equal(estimator.rateBps, 8e8, "the rest of what is cached comes as fast");
  estimator.add(10e3, 0.1);
  assert.equal(estimator.rateBps, 8e8);
  estimator.add(10e3, 0.1);
  const around = estimator.rateBps / 1e6;
  assert.ok(around > 0.7 && around < 0.9, "at once that of the link");
});

test("a play that has all it needs wakes its player once, however often it hears the position", async () => {
  const start = { manifest: manifestBytes({}), numFrames: manifestOf({}).segmentFrames };
  const stream = new ServedStream(BASE, new Fetcher(), { response: { token: "t" }, start });
  const play = stream.play({ firstFrame: 0, mostLayers: 1, nowS: () => 0 });
  play.endBirth = stream.numFrames;
  let woken = 0;
  play.onData = () => (woken += 1);
  for (let n = 0; n < 9; n++) {
    await settled();
    play.reportPosition(0, true, 1);
  }
  assert.deepEqual([woken, play.isDone], [1, true]);
  play.close();
});

test("a seek into what came without keyframes fetches those of all layers", async (context) => {
  const numFrames = 3 * manifestOf({}).segmentFrames;
  const start = { manifest: manifestBytes({}), numFrames };
  const stream = new ServedStream(BASE, new Fetcher(), { response: { token: "t" }, start });
  const { cache, manifest } = stream;
  for (let birth = 0; birth < numFrames; birth++) {
    for (let part = 0; part <= skipMapsOf(manifest); part++)
      cache.add(birth, part, Uint8Array.of(1));
  }
  const { numLayers } = manifest;
  const play = stream.play({ firstFrame: 0, mostLayers: numLayers, nowS: () => 0 });
  context.after(() => play.close());
  play.endBirth = numFrames;
  const asked = [];
  const object = filesOf("one-lane")["segments/0/keyframe-0"];
  answering(context, (url) => asked.push(url.slice(BASE.length)) && new Response(object));
  assert.equal(play.moveTo(0, "seek"), true);
  while (cache.missingKeyframes(0, numLayers).length > 0) await settled();
  const layers = Array.from({ length: numLayers }, (_, layer) => layer);
  assert.deepEqual(
    asked,
    layers.map((layer) => `segments/0/keyframe-${layer}`),
  );
});
