/** The play worker as a page sees it: what it posts when its stream fails. */
import assert from "node:assert/strict";
import { test } from "node:test";

import { filesOf } from "./support.mjs";
import { VirtualHost } from "./virtualhost.mjs";

const FILES = filesOf("far");

const posted = [];
/** The scope of the worker, which its modules take once. */
const scope = (globalThis.self = { postMessage: (message) => posted.push(message) });

test("nothing follows on a failure, also if it is found while a live stream is looked for", async (context) => {
  posted.length = 0;
  context.mock.method(console, "warn", () => {});
  const described = JSON.parse(Buffer.from(FILES["manifest.json"]).toString());
  const manifest = JSON.stringify({ ...described, live: true });
  const other = filesOf("leases");
  let index = FILES["index.bin"];
  const answer = (path) => {
    if (path === "manifest.json") return new Response(manifest);
    return new Response(path === "index.bin" ? index : FILES[path]);
  };
  const host = new VirtualHost(context, answer, () => 0.02);
  await import("../playback/playworker.js");
  const { port1, port2 } = new MessageChannel();
  context.after(() => port2.close());
  const posts = (data) => scope.onmessage({ data });
  posts({ kind: "open", base: "http://host/", port: port1 });
  const has = (kind) => posted.some((message) => message.kind === kind);
  await host.untilAsked();
  await host.until(() => has("opened"));
  posts({ kind: "play", playing: true });
  await host.until(() => has("state"));
  index = other["index.bin"];
  await host.until(() => has("failed"), 100);
  const { message } = posted.at(-1);
  posted.length = 0;
  posts({ kind: "play", playing: true });
  const endMs = host.nowMs + 3000;
  await host.until(() => host.nowMs >= endMs);
  assert.deepEqual(posted, []);
  assert.match(message, /^This video was replaced|^http/);
});

test("what is wrong with the bytes is a detail of a message that names the stream", async (context) => {
  posted.length = 0;
  const host = new VirtualHost(
    context,
    () => new Response("{}"),
    () => 0.02,
  );
  await import("../playback/playworker.js?another");
  scope.onmessage({ data: { kind: "open", base: "http://host/clip/" } });
  await host.untilAsked();
  await host.until(
    () => posted.length > 0,
    () => false,
  );
  assert.match(posted[0].message, /^http:\/\/host\/clip\/: manifest: /);
});
