/** What goes wrong is told to who asked, or said on the console. */
import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { test } from "node:test";
import { sentenceOf } from "../controls/panels.js";
import { Smoothing } from "../renderer/smoothing.js";

const WEB = new URL("../", import.meta.url);

test("no module drops an error without a word, or a reason", () => {
  const found = readdirSync(WEB, { recursive: true })
    .filter((path) => path.endsWith(".js") && !/^(bundle|dist|node_modules|tools)\b/.test(path))
    .filter((path) => {
      const lines = readFileSync(new URL(path, WEB), "utf8").split("\n");
      // An error may be dropped if a sentence beside says why.
      const isBare = (line, n) =>
        /catch \{|catch\(\(\) => /.test(line) && !/\/\/ |\*\//.test(line + lines[n - 1]);
      return lines.some(isBare);
    });
  assert.deepEqual(found, []);
});

test("a device that refuses motion between frames is named, and shows each frame", (context) => {
  const { mock } = context.mock.method(console, "warn", () => {});
  const view = { manifest: { numGs: 1 } };
  view.smoothing = new Smoothing(view);
  for (const isLost of [true, false]) {
    const gl = { isContextLost: () => isLost }; // and can do nothing
    view.smoothing.attach({ inbetween: null, gl, defines: {}, resident: {} });
    assert.equal(view.smoothing === null, !isLost, "a lost device gets another renderer");
    assert.equal(mock.callCount(), isLost ? 0 : 1);
  }
  assert.match(String(mock.calls[0].arguments[0]), /no motion between frames/);
});

test("viewers get a sentence without addresses", () => {
  const gone = "The host of this video cannot be reached. Check the network and try again.";
  for (const [message, sentence] of [
    ["http://host/0/0 cannot be reached; check the network and try again", gone],
    ["http://host/v1/streams/clip/: The host does not answer", gone],
    [
      "http://host/clip/: The server reports: this stream is damaged on the server",
      "This video is damaged on its server.",
    ],
    ["http://host/0/0: HTTP 404", "This video does not exist, or is not here any more."],
    ["http://host/: manifest: fps is 0", "This video cannot be played."],
    ["This video was replaced", "This video was replaced."],
  ])
    assert.equal(sentenceOf(message), sentence);
});
