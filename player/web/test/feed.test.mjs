/** A feed of Gaussians for other renderers: what it asks its workers for. */
import assert from "node:assert/strict";
import { test } from "node:test";

import { GaussianFeed } from "../feed/gaussianfeed.js";
import { answering } from "./support.mjs";

/** A feed of `src` in a page whose workers only note what is posted to them. */
function made(context, src) {
  const page = Object.assign(new EventTarget(), {
    baseURI: "http://page/dir/",
    hidden: false,
    createElement: () => ({}),
    head: { append: () => {} },
  });
  const workers = [];
  class Worker {
    constructor() {
      this.posted = [];
      workers.push(this);
    }
    postMessage(message) {
      this.posted.push(message);
    }
    terminate() {
      this.isEnded = true;
    }
  }
  class MessageChannel {
    port1 = {};
    port2 = {};
  }
  for (const [name, value] of Object.entries({ document: page, Worker, MessageChannel })) {
    const before = globalThis[name];
    globalThis[name] = value;
    context.after(() => (globalThis[name] = before));
  }
  answering(context, () => new Promise(() => {}));
  const feed = new GaussianFeed(src);
  const [keeper, player] = workers;
  const says = (data) => player.onmessage({ data });
  const open = () =>
    says({ kind: "opened", manifest: { numGs: 2, shDegree: 0, live: true }, numFrames: 30 });
  return { feed, page, workers, says, open, keeper, posted: player.posted };
}

test("a feed opens folders and packed streams", (context) => {
  assert.equal(made(context, "movie.swings").posted[0].base, "http://page/dir/movie.swings");
  assert.equal(made(context, "clip?key=1").posted[0].base, "http://page/dir/clip/?key=1");
});

test("a feed grows with a live stream", async (context) => {
  const { feed, says, open } = made(context, "clip");
  open();
  assert.equal((await feed.opened).numFrames, 30);
  const found = [];
  feed.addEventListener("grown", () => found.push([feed.stream.numFrames, feed.stream.live]));
  says({ kind: "grown", numFrames: 300, live: true });
  says({ kind: "grown", numFrames: 310, live: false });
  assert.deepEqual(found, [
    [300, true],
    [310, false],
  ]);
});

test("a feed plays while its page is visible", (context) => {
  const { feed, page, says, open, posted } = made(context, "clip");
  open();
  const show = (isShown) => {
    page.hidden = !isShown;
    page.dispatchEvent(new Event("visibilitychange"));
  };
  posted.length = 0;
  feed.play();
  show(false);
  show(true);
  says({ kind: "ended" });
  show(false);
  show(true);
  const playing = posted.map((message) => message.playing);
  assert.deepEqual(playing, [true, false, true]);
});

test("what is set before the stream is open holds, but a seek needs its frames", (context) => {
  const { feed, keeper, open, posted } = made(context, "clip");
  assert.throws(() => feed.seek(7), /not open yet/);
  feed.play();
  feed.setRate(2);
  open();
  const rates = posted.filter(({ kind }) => kind === "rate");
  assert.deepEqual(
    [rates, posted.at(-1)],
    [[{ kind: "rate", rate: 2 }], { kind: "play", playing: true }],
  );
  feed.seek(99);
  assert.deepEqual(posted.at(-1), { kind: "seek", frame: 29, seeks: 1 });
  assert.equal(feed.isSeeking, true);
  const slots = Uint32Array.of(1);
  const gaussians = { means: Float32Array.of(1, 2, 3), opacities: Float32Array.of(0.5) };
  for (const seeks of [0, 1]) {
    keeper.onmessage({
      data: { frame: 29, slots, gaussians: { ...feed.gaussians, ...gaussians }, seeks },
    });
    assert.equal(feed.take(), slots);
    assert.equal(feed.isSeeking, seeks === 0);
  }
  assert.deepEqual([...feed.gaussians.means], [0, 0, 0, 1, 2, 3]);
  assert.deepEqual([feed.frame, feed.take(), keeper.posted.at(-1)], [29, null, { take: true }]);
});

test("a feed that failed has no workers", async (context) => {
  const { feed, workers, says } = made(context, "clip");
  says({ kind: "failed", message: "gone" });
  await assert.rejects(feed.opened, /gone/);
  assert.deepEqual(
    workers.map(({ isEnded }) => isEnded),
    [true, true],
  );
});
