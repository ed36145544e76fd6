/** Layers and stalls of a play from a static host over links of all kinds, in virtual time. */
import assert from "node:assert/strict";
import { test } from "node:test";

import { LONG, watched } from "./virtuallink.mjs";

/** The same in small objects. */
const SMALL = Object.fromEntries(
  Object.entries(LONG).map(([key, one]) => [
    key,
    Array.isArray(one) ? one.map((n) => n / 10) : one / 10,
  ]),
);

/**
 * Mbit/s and round trip of a link; whether each transfer begins slowly; most stalls; seconds until all layers
 * show at the latest; seconds that are watched.
 */
const LINKS = [
  [100, 0.02, { isSlow: true, allByS: 0.5 }],
  [100, 0.2, { allByS: 3 }],
  [100, 0.2, { isSlow: true, allByS: 4 }],
  [100, 0.2, { isSlow: true, allByS: 3.1, connections: 100 }],
  [20, 0.1, { isSlow: true, allByS: 1.5 }],
  [3, 0.15, {}],
  [3, 0.15, { isSlow: true }],
  [3, 0.15, { of: SMALL, allByS: 3 }],
  [2, 0.15, { isSlow: true }],
  [0.4, 0.15, { mostStalls: 4, forS: 45 }],
];

for (const [mbit, rttS, { allByS, mostStalls = 0, of = LONG, ...how }] of LINKS) {
  const kind = `${of === SMALL ? " small objects" : ""}${how.isSlow ? " slow start" : ""}`;
  test(`${mbit} Mbit/s, ${1000 * rttS} ms${kind}`, async () => {
    const found = await watched({ rateBps: 1e6 * mbit, rttS, ...of, ...how });
    const all = found.shown.find(({ layers }) => layers === of.layerBytes.length);
    if (allByS !== undefined) assert.ok(all !== undefined && all.atS <= allByS, `at ${all?.atS} s`);
    if (allByS !== undefined) {
      const later = found.shown.filter(({ atS }) => atS > 5).map(({ layers }) => layers);
      const mean = later.reduce((sum, layers) => sum + layers, 0) / later.length;
      assert.ok(mean > 0.95 * of.layerBytes.length, `${mean} layers after 5 s`);
    }
    assert.ok(found.stalls <= mostStalls, `${found.stalls} stalls`);
    // A far host is as far as its connections carry, which is less than the link.
    assert.ok(found.rateBps < 1.05e6 * mbit, `${found.rateBps} bit/s`);
    if (mbit <= 3)
      assert.ok(of === SMALL || found.rateBps > 0.9e6 * mbit, `${found.rateBps} bit/s`);
  });
}
