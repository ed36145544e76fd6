/**
 * Measures with gzip what a page loads before its first picture, by the kind of its stream; fails above the budget.
 * Prints the tag with which a page of another host loads the element.
 */
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { gzipSync } from "node:zlib";

const BUDGET_BYTES = 50_000;
const BUNDLE = new URL("../bundle/", import.meta.url);

const size = (/** @type {string} */ name) => gzipSync(readFileSync(new URL(name, BUNDLE))).length;

const { first, harmonics } = JSON.parse(readFileSync(new URL("manifest.json", BUNDLE), "utf8"));
for (const [kind, names] of Object.entries(first)) {
  const sizes = names.map(size);
  const sum = sizes.reduce((/** @type {number} */ all, /** @type {number} */ one) => all + one);
  const parts = names.map(
    (/** @type {string} */ name, /** @type {number} */ n) => `${name} ${sizes[n]}`,
  );
  console.info(`${kind}: ${sum} of ${BUDGET_BYTES} bytes (${parts.join(", ")})`);
  if (sum > BUDGET_BYTES) process.exitCode = 1;
}
console.info(`harmonics of degree 2 and 3: ${size(harmonics)} more (${harmonics})`);
const player = readFileSync(new URL("player.js", BUNDLE));
const hash = createHash("sha384").update(player).digest("base64");
const src = "https://cdn.example.com/swings-VERSION/bundle/player.js";
console.info(`<script type="module" crossorigin integrity="sha384-${hash}" src="${src}"></script>`);
