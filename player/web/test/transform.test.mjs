/** A page's function that changes requests, in the page and asked by a worker. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { requestPort } from "../playback/playerworkers.js";
import { Fetcher } from "../source/fetcher.js";
import { fetchRange, fileBytes } from "../source/files.js";
import { pictureUrl } from "../source/addresses.js";
import { openSource } from "../source/source.js";
import { transformed } from "../source/transform.js";
import { answering, filesOf } from "./support.mjs";

const BASE = "http://host/clip/?token=a";

/** Both ways to a page's function. */
const WAYS = {
  page: (_context, action) => action,
  worker: (context, action) => {
    const port = requestPort(action, assert.fail);
    context.after(() => port.close());
    return port;
  },
};

for (const [place, way] of Object.entries(WAYS)) {
  test(`a function of the page changes each request: ${place}`, async (context) => {
    const files = filesOf("one-lane");
    const asked = [];
    answering(context, (url, { headers, credentials }) => {
      asked.push([url, headers.get("authorization"), credentials]);
      return new Response(files[new URL(url).pathname.replace("/moved/clip/", "")]);
    });
    let calls = 0;
    const transformRequest = way(context, async (url) => ({
      url: new URL(url).pathname.replace(/^/, "/moved"),
      headers: { Authorization: `Bearer ${++calls}` },
      credentials: "omit",
    }));
    const fetcher = new Fetcher({ credentials: "include", transformRequest });
    const stream = await openSource(BASE, fetcher);
    await stream.object(stream.records[0], 0, () => {});
    await fileBytes(stream.fetcher, BASE, "manifest.json", null, 1e6);
    const paths = ["manifest.json", "index.bin", "segments/0/0", "manifest.json"];
    assert.deepEqual(
      asked.map(([url]) => url),
      paths.map((path) => `http://host/moved/clip/${path}`),
    );
    const tokens = asked.map(([, authorization]) => authorization).sort();
    assert.deepEqual(
      tokens,
      [1, 2, 3, 4].map((n) => `Bearer ${n}`),
    );
    assert.ok(asked.every(([, , credentials]) => credentials === "omit"));
  });

  test(`what a function of the page does wrong is said in one line: ${place}`, async (context) => {
    answering(context, () => assert.fail("a request that is not as the page wants it"));
    const wrong = [
      [() => 1, "it returned 1, not an object"],
      [() => ({ credentials: "all" }), "credentials may not be all"],
      [() => ({ url: "http://[0" }), "Invalid URL"],
      [() => Promise.reject("no token"), "no token"],
    ];
    for (const [action, why] of wrong) {
      const fetcher = new Fetcher({ transformRequest: way(context, action) });
      const message = `transformRequest failed for ${BASE}: ${why}`;
      await assert.rejects(fetcher.get(BASE, 10), { name: "SourceError", message });
    }
    const headers = () => ({ headers: { "a b": "" } });
    const fetcher = new Fetcher({ transformRequest: way(context, headers) });
    await assert.rejects(fetcher.get(BASE, 10), { name: "SourceError", message: /a b/ });
  });

  test(`a request of which the page thinks for long can be aborted: ${place}`, async (context) => {
    const transformRequest = way(context, () => new Promise(() => {}));
    const abort = new AbortController();
    const waits = transformed(transformRequest, BASE, { signal: abort.signal });
    abort.abort();
    await assert.rejects(waits, { name: "AbortError" });
  });
}

test("a function that changes nothing, and the player's own headers", async (context) => {
  const asked = [];
  answering(context, (url, { headers, credentials }) => {
    asked.push([url, headers.get("range"), credentials]);
    return new Response("ab", { status: 206 });
  });
  for (const change of [null, undefined, {}, { headers: [["Range", "bytes=7-"]] }]) {
    const fetcher = new Fetcher({ credentials: "include", transformRequest: () => change });
    await fetchRange(fetcher, BASE, { first: 1, size: 2 });
  }
  assert.deepEqual(asked, Array(4).fill([BASE, "bytes=1-2", "include"]));
});

test("a picture is fetched where the page changes requests", async (context) => {
  const type = "image/webp";
  globalThis.FileReader = class {
    async readAsDataURL(blob) {
      this.result = `data:${blob.type},${await blob.text()}`;
      this.onload();
    }
  };
  context.after(() => delete globalThis.FileReader);
  answering(context, (url, { headers, credentials }) => {
    const body = `${url} ${headers.get("key")} ${headers.get("range")} ${credentials}`;
    return new Response(body, { status: headers.has("range") ? 206 : 200 });
  });
  const transformRequest = () => ({ headers: { key: "k" } });
  const source = { credentials: "include", transformRequest };
  const folder = { base: "http://host/clip/", files: null, source };
  const url = "http://host/clip/a%20b.webp";
  assert.equal(await pictureUrl(folder, "a b.webp"), `data:${type},${url} k null include`);
  assert.equal(await pictureUrl({ ...folder, source: {} }, "a b.webp"), url);
  const packed = {
    ...folder,
    base: "http://host/a.swings",
    files: { "b.webp": { first: 2, size: 3 } },
  };
  assert.equal(
    await pictureUrl(packed, "b.webp"),
    `data:${type},http://host/a.swings k bytes=2-4 include`,
  );
  assert.equal(await pictureUrl(packed, "toString"), null);
});
