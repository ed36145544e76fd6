/** A player of a static host over a link of a given rate and round trip, in time that does not pass. */
import { Playback } from "../playback/playback.js";
import {
  hasObject,
  HostedDownload,
  RateEstimator,
  RequestWindow,
} from "../source/hosteddownload.js";
import { SegmentCache } from "../source/segmentcache.js";
import { manifestOf, settled } from "./support.mjs";

const STEP_S = 0.005;
/** Connections that a browser opens to a host that knows HTTP/1.1 only. */
const CONNECTIONS = 6;
const FIRST_WINDOW_BYTES = 14_600;

/** Transfers share the rate; each begins a round trip after its request, and slowly (TCP). */
class Link {
  constructor(rateBps, rttS, isSlow, connections) {
    this.isSlow = isSlow;
    this.rateBps = rateBps;
    this.rttS = rttS;
    this.nowS = 0;
    this.idle = Array.from({ length: connections }, () => ({
      isNew: true,
      window: FIRST_WINDOW_BYTES,
    }));
    this.asked = [];
    this.running = [];
  }

  get(numBytes, onBytes, signal) {
    return new Promise((resolve, reject) => {
      const one = { leftBytes: numBytes, onBytes, resolve };
      this.asked.push(one);
      signal.addEventListener("abort", () => {
        this.asked = this.asked.filter((other) => other !== one);
        this.running = this.running.filter((other) => other !== one);
        if (one.connection) this.idle.push({ isNew: true, window: FIRST_WINDOW_BYTES });
        reject(signal.reason);
      });
    });
  }

  step() {
    this.nowS += STEP_S;
    while (this.asked.length > 0 && this.idle.length > 0) {
      const one = this.asked.shift();
      one.connection = this.idle.pop();
      one.beginsS = this.nowS + this.rttS * (one.connection.isNew ? 2 : 1);
      one.connection.isNew = false;
      this.running.push(one);
    }
    let leftBytes = (this.rateBps * STEP_S) / 8;
    const sending = this.running.filter(({ beginsS }) => beginsS <= this.nowS);
    for (const [n, one] of sending.entries()) {
      const { connection } = one;
      const most =
        this.rttS > 0 && this.isSlow ? (connection.window * STEP_S) / this.rttS : Infinity;
      const bytes = Math.min(one.leftBytes, leftBytes / (sending.length - n), most);
      leftBytes -= bytes;
      one.leftBytes -= bytes;
      connection.window += bytes;
      one.onBytes(bytes);
      if (one.leftBytes > 1e-6) continue;
      this.running = this.running.filter((other) => other !== one);
      this.idle.push(connection);
      one.resolve();
    }
  }
}

/**
 * Plays a stream of 30 s; returns what showed.
 * @param {object} how
 * @param {number[]} how.layerBytes of a segment, layer by layer
 */
export async function watched({
  rateBps,
  rttS,
  layerBytes,
  skipMapsBytes,
  keyframeBytes,
  forS = 20,
  isSlow = false,
  connections = CONNECTIONS,
}) {
  const segmentFrames = 10;
  const manifest = manifestOf({ segment_frames: segmentFrames, slots: layerBytes.map(() => 5) });
  const objectBytes = [...layerBytes, skipMapsBytes, ...keyframeBytes];
  const records = Array.from({ length: 90 }, (_, segment) => {
    const firstFrame = segment * segmentFrames;
    return { segment, firstFrame, numFrames: segmentFrames, objectBytes };
  });
  const link = new Link(rateBps, rttS, isSlow, connections);
  const cache = new SegmentCache(manifest);
  const come = new Map();
  const stream = {
    manifest,
    records,
    cache,
    estimator: new RateEstimator(),
    absent: new Map(),
    window: new RequestWindow(),
  };
  stream.object = async (record, part, onBytes, signal) => {
    await link.get(objectBytes[part], onBytes, signal);
    const { firstFrame, numFrames } = record;
    const births = Array.from({ length: numFrames }, (_, n) => firstFrame + n);
    return new Map(births.map((birth) => [birth, Uint8Array.of(1)]));
  };
  const numLayers = layerBytes.length;
  const play = new HostedDownload(stream, {
    firstFrame: 0,
    mostLayers: numLayers,
    nowS: () => link.nowS,
  });
  const chunks = {
    isLate: false,
    has: (frame) => cache.keyframe(0, 0) !== null && frame === 0,
    canAdvance: (frame) => cache.hasSlice(frame),
    join: () => [],
    advance: () => ({ isJoin: false, updates: [] }),
  };
  const playback = new Playback(chunks, 30, 900, 0);
  playback.setPlaying(true);
  const hasLayer = (segment, layer) =>
    hasObject(cache, segment, `${layer}`, segmentFrames) &&
    (cache.keyframe(segment, layer) !== null ||
      (segment > 0 && come.get(`${segment - 1}/${layer}`)));
  const layersAt = (frame) => {
    const segment = Math.floor(frame / segmentFrames);
    for (let layer = 0; layer < numLayers; layer++)
      if (!come.get(`${segment}/${layer}`)) return layer;
    return numLayers;
  };
  const shown = [];
  while (link.nowS < forS) {
    link.step();
    await settled();
    play.step();
    for (let s = 0; s < 90; s++)
      for (let l = 0; l < numLayers; l++)
        // What comes when its segment is over does not show, and what follows on it neither.
        if (playback.nextFrame < (s + 1) * segmentFrames && hasLayer(s, l))
          come.set(`${s}/${l}`, true);
    playback.heldFrame = cache.endOf(playback.nextFrame, 900);
    playback.waitS = play.waitS;
    playback.isLinkThin = (play.rateBps ?? Infinity) < 24 * (layerBytes[0] + skipMapsBytes);
    const one = playback.tick(link.nowS);
    if (one !== null) {
      shown.push({ atS: link.nowS, frame: one.frame, layers: layersAt(one.frame) });
    }
    play.reportPosition(playback.nextFrame, false, 1);
    cache.setPlayhead(playback.nextFrame, null);
  }
  play.close();
  return { shown, stalls: playback.stalls, rateBps: play.rateBps };
}

/** Bytes of a third of a second: needs 1.4, 1.9, 2.5 and 3.3 Mbit/s with 1, 2, 3 and 4 layers. */
export const LONG = {
  layerBytes: [49_000, 20_400, 25_400, 34_000],
  skipMapsBytes: 9_000,
  keyframeBytes: [60_000, 25_000, 28_000, 40_000],
};
