/** A feed of Gaussians for other renderers: what it asks its workers for. */
import assert from "node:assert/strict";
import { test } from "node:test";

import { GaussianFeed } from "../feed/gaussianfeed.js";

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
  for (const [name, value] of Object.entries({ document: page, Worker })) {
    globalThis[name] = value;
    context.after(() => delete globalThis[name]);
  }
  const feed = new GaussianFeed(src);
  const [player] = workers;
  const says = (data) => player.onmessage({ data });
  const open = () =>
    says({ kind: "opened", manifest: { numGs: 2, shDegree: 0, live: true }, numFrames: 30 });
  return { feed, page, workers, says, open, posted: player.posted };
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
  assert.throws(() => feed.play(), /not open yet/);
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
  assert.deepEqual(playing, [true, false, true, false, false]);
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
