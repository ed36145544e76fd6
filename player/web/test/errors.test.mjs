/** What goes wrong is told to who asked, or said on the console. */
import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { test } from "node:test";

import { Smoothing } from "../element/smoothing.js";

const WEB = new URL("../", import.meta.url);

test("no module drops an error without a word", () => {
  const found = readdirSync(WEB, { recursive: true })
    .filter((path) => path.endsWith(".js") && !/^(bundle|npm)\b/.test(path))
    .filter((path) => readFileSync(new URL(path, WEB), "utf8").includes("catch {"));
  assert.deepEqual(found, ["source/objecturl.js"], "which throws an error that says more");
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
