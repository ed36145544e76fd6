/** What the tests of several modules need. */
import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { test } from "node:test";
import { fileURLToPath } from "node:url";
import { crc32, recordBytes } from "../format/objects.js";
import { readManifest } from "../format/manifest.js";
import { cross, subtract, unit } from "../view/vectors.js";

/** Random numbers that are the same for the same seed (Mulberry32). */
export class Random {
  constructor(seed) {
    this.state = seed;
  }

  /** At least `least`, and less than `end`. */
  number(least = 0, end = 1) {
    this.state = (this.state + 0x6d2b79f5) | 0;
    let t = Math.imul(this.state ^ (this.state >>> 15), 1 | this.state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return least + (((t ^ (t >>> 14)) >>> 0) / 2 ** 32) * (end - least);
  }

  /** From `least` to `most`. */
  integer(least, most) {
    return Math.floor(this.number(least, most + 1));
  }

  choice(list) {
    return list[this.integer(0, list.length - 1)];
  }

  /** A sum of uniform numbers, nearly normal. */
  normal() {
    return this.number(-2, 2) + this.number(-2, 2) + this.number(-2, 2);
  }

  vector() {
    return [this.normal(), this.normal(), this.normal()];
  }
}

/** A test of something that holds for all random numbers; a failure names the seed. */
export function law(name, count, holds) {
  test(name, async () => {
    for (let seed = 1; seed <= count; seed++) {
      try {
        await holds(new Random(seed));
      } catch (error) {
        throw new Error(`seed ${seed}: ${error.message}`, { cause: error });
      }
    }
  });
}

const LATTICE = {
  ...{ position_m: 0.001, log_scale: 0.05, log_scale_base: -3, rotation: 0.01, colour: 0.02 },
  opacity_levels: 256,
};

/** A camera of a manifest: in the origin, looking along z, unless `changes` says otherwise. */
export const camera = (changes) => ({
  ...{ name: "c0", width_px: 64, height_px: 48, fx_px: 60, fy_px: 60, cx_px: 32, cy_px: 24 },
  w2c: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
  ...changes,
});

export function manifestBytes({ slots = [5, 3, 2], ...changes } = {}) {
  const cameras = changes.cameras ?? [camera()];
  const bounds = [2, 6].map((z, upper) => (upper ? [2, 2, z] : [-2, -2, z]));
  const manifest = {
    ...{ version: 1, fps: 30, swin_size: 1, segment_frames: 30, sh_degree: 0, antialias: false },
    ...{ near_m: 0.5, bounds, cameras, default_camera: cameras[0].name, live: false, slots },
    ...{ num_gs: slots.reduce((sum, one) => sum + one), lattice: slots.map(() => LATTICE) },
    ...{ poster: null, object_url: "segments/{segment}/{layer}", title: "", capture_frame: 0 },
    ...changes,
  };
  return new TextEncoder().encode(JSON.stringify(manifest));
}

/** The manifest of a stream of three layers, of segments of a second. */
export const manifestOf = (changes) => readManifest(manifestBytes(changes));

/** A record of index.bin. */
export function recordOf(manifest, segment, hash = 1) {
  const row = new Uint8Array(recordBytes(manifest)).fill(hash);
  const view = new DataView(row.buffer);
  const { segmentFrames, numLayers, parts } = manifest;
  for (const [n, value] of [segment, segment * segmentFrames, segmentFrames, 0].entries())
    view.setUint32(4 * n, value, true);
  for (let part = 0, at = 16; part < parts.length; part++) {
    view.setBigUint64(at, 100n, true);
    if (part < numLayers) view.setFloat32(at + 40, NaN, true);
    at += part < numLayers ? 44 : 40;
  }
  view.setUint32(row.length - 4, crc32(row.subarray(0, -4)), true);
  return row;
}

/** A record of a play in msgpack: of short texts, small numbers, and bytes with a size of 16 bits. */
export function playRecord(fields) {
  const text = (one) => [0xa0 + one.length, ...Buffer.from(one)];
  const coded = (one) => {
    if (typeof one === "number") return [one];
    if (typeof one === "string") return text(one);
    return [0xc5, one.length >> 8, one.length & 255, ...one];
  };
  const pairs = Object.entries(fields).flatMap(([name, one]) => [...text(name), ...coded(one)]);
  const body = Buffer.from([0x80 + Object.keys(fields).length, ...pairs]);
  return Buffer.concat([Buffer.from(Uint32Array.of(body.length).buffer), body]);
}

export const startRecord = (manifest) =>
  playRecord({ kind: "start", from: 0, num_frames: 1, manifest });

export const joined = (parts) => Uint8Array.from(Buffer.concat(parts));

/** The files of a stream of the conformance suite, by path. */
export function filesOf(name) {
  const folder = fileURLToPath(new URL(`../../../conformance/streams/${name}/`, import.meta.url));
  const names = readdirSync(folder, { recursive: true, withFileTypes: true });
  return Object.fromEntries(
    names
      .filter((entry) => entry.isFile())
      .map(({ parentPath, name: file }) => {
        const path = `${parentPath}/${file}`;
        return [path.slice(folder.length).replace(/^\//, ""), Uint8Array.from(readFileSync(path))];
      }),
  );
}

/** Lets everything run that waits for nothing but its turn. */
export const settled = () => new Promise((resolve) => setImmediate(resolve));

/** Replaces `fetch` until the test ends. */
export function answering(context, answer) {
  return context.mock.method(globalThis, "fetch", async (url, init = {}) => {
    init.signal?.throwIfAborted();
    return answer(url, init);
  });
}

/** Fails unless all numbers are `wanted`, but for rounding. */
export function near(found, wanted, off = 1e-9) {
  assert.equal(found.length, wanted.length);
  const isNear = (one, n) => Math.abs(found[n] - one) <= off * Math.max(1, Math.abs(one));
  assert.ok(wanted.every(isNear), `${found} is not near ${wanted}`);
}

/** The pose of a camera at a place that looks at another one, down as far as possible along `down`. */
export function posed(position, target, down = [0, 1, 0]) {
  const forward = unit(subtract(target, position));
  const right = unit(cross(down, forward));
  return { position, right, down: cross(forward, right), forward };
}

/** Objects that a host lacks or has damaged, and the layers that a player shows of each segment then. */
export const HOLES = JSON.parse(
  readFileSync(new URL("../../../tests/player/source/holes.json", import.meta.url), "utf8"),
);
