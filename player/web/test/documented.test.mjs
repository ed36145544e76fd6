/** What docs/EMBED.md quotes, the player says. */
import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { test } from "node:test";

import { elementsManifest } from "../tools/elements.js";

const WEB = new URL("../", import.meta.url);

test("the documentation names every public member, attribute, event, part and state of the element", () => {
  const text = readFileSync(new URL("../../docs/EMBED.md", WEB), "utf8");
  const [, element] = text.split(/^## The element$/m);
  const code = [...element.matchAll(/`([^`]+)`/g)].map(([, one]) => one).join(" ");
  const named = new Set(code.match(/[\w-]+/g));
  const [declared] = elementsManifest().modules[0].declarations;
  const { members, attributes, events, cssParts, cssStates } = declared;
  const all = [members, attributes, events, cssParts, cssStates].flat().map(({ name }) => name);
  assert.deepEqual(
    all.filter((name) => !named.has(name)),
    [],
  );
  for (const name of ["flyToCamera", "play", "captureStream", "volume", "max-gaussians"])
    assert.ok(all.includes(name), `the analyser finds ${name}`);
  assert.deepEqual(
    attributes.filter(({ description }) => !description),
    [],
  );
});

test("the messages that the documentation quotes are those of the player", () => {
  const sources = readdirSync(WEB, { recursive: true })
    .filter((path) => /^(element|source)\/.*\.js$/.test(path))
    .map((path) => readFileSync(new URL(path, WEB), "utf8").replace(/["`] \+\s+["`]/g, ""))
    .join("\n");
  const text = readFileSync(new URL("../../docs/EMBED.md", WEB), "utf8");
  const cells = text.split("## If it does not play")[1].matchAll(/^\| (.*?) \|/gm);
  const quotes = [...cells].flatMap(([, cell]) =>
    [...cell.matchAll(/"([^"]+)"/g)].map(([, one]) => one),
  );
  for (const quote of quotes) {
    // Capitals stand for an address; what follows a semicolon may be added elsewhere.
    for (const piece of quote.split(/\b(?:HOST|URL)\b|\.\.\.|;/).map((one) => one.trim()))
      assert.ok(sources.includes(piece), `no message has: ${piece}`);
  }
  assert.ok(quotes.length >= 7);
});
