/**
 * Plays streams of a static host over links in virtual time with the browser's own code: one JSON
 * object a line in, the objects that came a line out.
 */
import { createInterface } from "node:readline";

import { Playback } from "../../player/web/playback/playback.js";
import { HostedStream } from "../../player/web/source/hosted.js";

/** Bytes of a piece as the page sees it come. */
const PIECE_BYTES = 16 * 1024;
const MOST_S = 20_000;

/** A link that repeats its steps; what is asked for passes in the order of asking. */
class Link {
  /** @param {[number, number, number][]} steps seconds, bits per second, latency in seconds */
  constructor(steps) {
    this.steps = steps;
    this.at = 0;
    this.endS = steps[0][0];
    this.freeS = 0;
  }

  /** The step of `timeS`, which never goes back. @param {number} timeS */
  #step(timeS) {
    while (timeS >= this.endS) {
      this.at = (this.at + 1) % this.steps.length;
      this.endS += this.steps[this.at][0];
    }
    return this.steps[this.at];
  }

  /**
   * When bytes that are asked for have come; the latency is that of a round trip.
   * @param {number} askedS
   * @param {number} numBytes
   */
  comesS(askedS, numBytes) {
    this.freeS = Math.max(this.freeS, askedS);
    for (let bits = 8 * numBytes; ; ) {
      const [, rateBps, latencyS] = this.#step(this.freeS);
      const passing = rateBps * (this.endS - this.freeS);
      if (passing >= bits) {
        this.freeS += bits / Math.max(rateBps, 1);
        return this.freeS + latencyS;
      }
      bits -= passing;
      this.freeS = this.endS;
    }
  }
}

/** Lets all go on that waits for a promise. */
const settled = () => new Promise((resolve) => setImmediate(resolve));

/** @param {string} text */
const unhex = (text) => Uint8Array.from(Buffer.from(text, "hex"));

/** @param {any} question */
async function play({ manifest, index, steps }) {
  const link = new Link(steps);
  const files = { "manifest.json": unhex(manifest), "index.bin": unhex(index) };
  const fetcher = {
    onTrouble() {},
    get: async (url) => files[url.split("/").at(-1)],
  };
  const stream = await HostedStream.open("https://host/", /** @type {any} */ (fetcher));
  let nowS = 0;
  /** What is on its way, piece by piece. */
  const coming = [];
  stream.object = (record, part, onBytes) =>
    new Promise((resolve) => {
      const total = record.objectBytes[part];
      const name = stream.manifest.parts[part];
      for (let left = total; left > 0; left -= PIECE_BYTES) {
        const numBytes = Math.min(left, PIECE_BYTES);
        const timeS = Math.max(link.comesS(nowS, numBytes), coming.at(-1)?.timeS ?? 0);
        const isWhole = left <= PIECE_BYTES;
        const came = () => {
          onBytes(numBytes);
          if (!isWhole) return;
          arrivals.push([timeS, total, record.segment, name]);
          here.add(`${record.segment}/${name}`);
          resolve(new Map());
        };
        coming.push({ timeS, came });
      }
    });
  const arrivals = [];
  /** @type {Set<string>} */
  const here = new Set();
  const { fps, segmentFrames, numLayers: mostLayers } = stream.manifest;
  const hasPart = (/** @type {number} */ frame, /** @type {string} */ part) =>
    here.has(`${Math.floor(frame / segmentFrames)}/${part}`);
  const hasSlice = (/** @type {number} */ frame) =>
    hasPart(frame, "0") && hasPart(frame, "skipmaps");
  const shown = {
    canAdvance: hasSlice,
    has: (/** @type {number} */ frame) => hasPart(frame, "keyframe-0"),
    join: () => [],
    advance: () => ({ isJoin: false, updates: [] }),
  };
  const { numFrames } = stream;
  const playback = new Playback(/** @type {any} */ (shown), fps, numFrames, 0);
  playback.setPlaying(true);
  const source = stream.play({ firstFrame: 0, mostLayers, nowS: () => nowS });
  while (!playback.hasEnded && nowS < MOST_S) {
    if (source.failure !== null) throw source.failure;
    const waitS = source.step();
    if (playback.tick(nowS) !== null) source.reportPosition(playback.nextFrame, false, 1);
    const nextS = nowS + Math.max(1e-4, Math.min(waitS, playback.restS(nowS) ?? 1));
    nowS = coming.length > 0 ? Math.max(nowS, Math.min(nextS, coming[0].timeS)) : nextS;
    let hasCome = false;
    while (coming.length > 0 && coming[0].timeS <= nowS) {
      coming.shift()?.came();
      hasCome = true;
    }
    if (hasCome) await settled();
  }
  return { arrivals, stalls: playback.stalls };
}

for await (const line of createInterface({ input: process.stdin })) {
  process.stdout.write(`${JSON.stringify(await play(JSON.parse(line)))}\n`);
}
