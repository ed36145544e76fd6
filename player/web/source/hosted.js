import { growMedia, streamMedia } from "../delivery/media.js";
import { PlaySession } from "../delivery/session.js";
import { corrupt } from "../format/bytes/errors.js";
import { checkGaussians, objectPath, readManifest } from "../format/manifest.js";
import { GZIP, readObject } from "../format/objecttable.js";
import { inflatePacket, limitBytes } from "../format/packet.js";
import { SourceError } from "./fetcher.js";
import { follow } from "./follow.js";
import { GrowingIndex } from "./growingindex.js";
import { followPeriodS } from "./liveedge.js";

const MAX_MANIFEST_BYTES = 2 ** 20;

/** @typedef {import("./source.js").Sink} Sink */

/** A stream of files on any static host: whole objects are fetched, in the order of what they are worth. */
export class HostedStream {
  /**
   * @param {string} base URL of the folder, with a slash at its end
   * @param {import("./fetcher.js").Fetcher} fetcher
   * @param {import("../format/manifest.js").Manifest} manifest
   */
  constructor(base, fetcher, manifest) {
    this.base = base;
    this.fetcher = fetcher;
    this.manifest = manifest;
    this.index = new GrowingIndex(`${base}index.bin`, fetcher, manifest);
    /** @type {number | null} what the last play took the link to carry */
    this.rateBps = null;
    /** What all plays of it see grow. */
    this.media = streamMedia(manifest, []);
  }

  /**
   * Reads manifest and index; waits for the first frames of a live stream. Rejects with a SourceError
   * or a FormatError.
   * @param {string} base
   * @param {import("./fetcher.js").Fetcher} fetcher
   * @param {number | null} maxGaussians see `checkGaussians`
   */
  static async open(base, fetcher, maxGaussians = null) {
    const manifest = await fetchManifest(base, fetcher);
    checkGaussians(manifest, maxGaussians, base);
    const stream = new HostedStream(base, fetcher, manifest);
    growMedia(stream.media, stream.manifest, await stream.index.refresh());
    if (stream.numFrames > 0) return stream;
    while (stream.manifest.live && stream.numFrames === 0) {
      fetcher.onTrouble("This stream has no frames yet; it starts when the first frames arrive");
      await new Promise((resolve) => setTimeout(resolve, 1000 * followPeriodS(stream.manifest)));
      await stream.refresh();
    }
    fetcher.onTrouble(null);
    if (stream.numFrames === 0) throw new SourceError(`${base} ended before its first frame`);
    return stream;
  }

  /** Takes in what is new of a live stream; gives whether anything is. Rejects as `open` does. */
  async refresh() {
    // Before the index: a manifest that says finished then goes with a whole index.
    const { live } = await fetchManifest(this.base, this.fetcher);
    const fresh = await this.index.refresh();
    const hasEnded = this.manifest.live && !live;
    this.manifest = { ...this.manifest, live };
    growMedia(this.media, this.manifest, fresh);
    return hasEnded || fresh.length > 0;
  }

  /**
   * @param {Sink} sink
   * @param {import("./source.js").Wish} wish
   */
  play(sink, wish) {
    return new HostedPlay(this, sink, wish);
  }

  /** Follows it while it grows. @param {() => void} onGrown */
  follow(onGrown) {
    return follow(this, onGrown);
  }

  get records() {
    return this.index.records;
  }

  get numFrames() {
    return this.media.numFrames;
  }

  /**
   * The packets of an object. Rejects with a SourceError or a FormatError.
   * @param {import("../format/streamindex.js").SegmentRecord} record
   * @param {string} part
   * @param {(numBytes: number) => void} onBytes
   */
  async object(record, part, onBytes) {
    const { manifest } = this;
    const url = new URL(objectPath(manifest, record.segment, part), this.base).href;
    const size = record.objectBytes[manifest.parts.indexOf(part)];
    const bytes = await this.fetcher.get(url, size, onBytes);
    if (bytes.length !== size)
      throw corrupt(`${url} has ${bytes.length} bytes, but the index says ${size}`);
    const { coder, packets } = readObject(bytes, manifest.version);
    if (coder !== GZIP) {
      throw new SourceError(
        "A browser cannot play this stream from a static host; export it: swings-stream export --static",
      );
    }
    return packets;
  }
}

/**
 * The manifest as it is now. Rejects with a SourceError or a FormatError.
 * @param {string} base
 * @param {import("./fetcher.js").Fetcher} fetcher
 */
async function fetchManifest(base, fetcher) {
  const init = /** @type {RequestInit} */ ({ cache: "no-cache" });
  return readManifest(
    await fetcher.get(`${base}manifest.json`, MAX_MANIFEST_BYTES, undefined, init),
  );
}

/**
 * Inflates the packets of an object, and hands the chunks to a sink. Rejects with a FormatError.
 * @param {import("../format/manifest.js").Manifest} manifest
 * @param {import("../format/streamindex.js").SegmentRecord} record
 * @param {string} part
 * @param {Map<number, Uint8Array>} packets by birth
 * @param {Sink} sink
 */
export async function handOver(manifest, record, part, packets, sink) {
  const layer = Number(part.replace("snapshot-", ""));
  const early = record.segment === 0 && !manifest.layout ? manifest.swinSize - 1 : 0;
  const limit = limitBytes(manifest, part);
  for (let n = -early; n < record.numFrames; n++) {
    const birth = record.firstFrame + n;
    const chunk = await inflatePacket(packets.get(birth) ?? new Uint8Array(0), limit);
    if (part === "masks") sink.addMask(birth, chunk);
    else if (!part.startsWith("snapshot-")) sink.addChange(birth, layer, chunk);
    else if (chunk.length > 0) sink.addSnapshot(birth, layer, chunk);
  }
}

/**
 * The parts of a segment that hold what was chosen.
 * @param {import("../delivery/outlook.js").Send} send
 * @param {import("../format/manifest.js").Manifest} manifest
 */
function partsOf({ kind, firstLayer, endLayer }, { layout }) {
  const parts = [];
  for (let layer = firstLayer; layer < endLayer; layer++) {
    if (kind === "snapshots") parts.push(`snapshot-${layer}`);
    else parts.push(...(layer === 0 && layout ? ["masks", "0"] : [String(layer)]));
  }
  return parts;
}

/** One play of a hosted stream: fetches what the session decides, and hands it over. */
export class HostedPlay {
  /**
   * @param {HostedStream} stream
   * @param {Sink} sink
   * @param {import("./source.js").Wish} wish
   */
  constructor(stream, sink, { firstFrame, mostLayers, nowS }) {
    this.stream = stream;
    this.sink = sink;
    this.mostLayers = mostLayers;
    this.nowS = nowS;
    const { media, rateBps } = stream;
    this.session = new PlaySession(media, nowS(), { firstFrame, rateBps });
    this.comeBytes = 0;
    /** @type {unknown} */
    this.failure = null;
    this.isClosed = false;
    /** @type {Map<number, Set<string>>} parts that were asked for, by segment */
    this.fetched = new Map();
    /** @type {() => void} called when something has come or failed */
    this.onNews = () => {};
  }

  get rateBps() {
    return this.session.rateBps;
  }

  /**
   * @param {number} frame
   * @param {boolean} paused
   */
  told(frame, paused) {
    this.session.told(this.nowS(), frame, paused);
  }

  /** Asks for what is worth it now; gives seconds until it should be called again, at most. */
  step() {
    for (;;) {
      const nowS = this.nowS();
      this.session.acknowledge(nowS, this.comeBytes);
      const decision = this.session.decide(nowS);
      this.#forget();
      switch (decision.kind) {
        case "slices":
        case "snapshots":
          this.#ask(decision, nowS);
          break;
        case "waitUntil":
          return Math.max(0, decision.timeS - nowS);
        default:
          return 0.1;
      }
    }
  }

  /**
   * Whole objects: of each segment that holds some of what was chosen.
   * @param {import("../delivery/outlook.js").Send} send
   * @param {number} nowS
   */
  #ask(send, nowS) {
    const { manifest, records } = this.stream;
    const [first, last] =
      send.kind === "slices" ? [send.birth, send.endBirth - 1] : [send.frame, send.frame];
    const endSegment = this.#segment(last) + 1;
    let numBytes = 0;
    for (let segment = this.#segment(first); segment < endSegment; segment++) {
      if (send.firstLayer >= this.mostLayers) break;
      for (const part of partsOf(send, manifest)) {
        if (!this.#isNew(segment, part)) continue;
        numBytes += records[segment].objectBytes[manifest.parts.indexOf(part)];
        this.#fetch(records[segment], part);
      }
    }
    const { firstFrame, numFrames } = records[endSegment - 1];
    const endBirth = firstFrame + numFrames;
    this.session.sent(send.kind === "slices" ? { ...send, endBirth } : send, numBytes, nowS);
  }

  /** @param {number} birth */
  #segment(birth) {
    return Math.floor(Math.max(birth, 0) / this.stream.manifest.segmentFrames);
  }

  /**
   * Whether an object was not asked for yet; it counts as asked for from now on.
   * @param {number} segment
   * @param {string} part
   */
  #isNew(segment, part) {
    const parts = this.fetched.get(segment) ?? new Set();
    if (parts.has(part)) return false;
    this.fetched.set(segment, parts.add(part));
    return true;
  }

  /** Forgets what was asked for of segments of which nothing shows any more. */
  #forget() {
    const oldest = this.#segment(this.session.oldestFrame - this.stream.manifest.swinSize + 1);
    for (const segment of this.fetched.keys()) if (segment < oldest) this.fetched.delete(segment);
  }

  /**
   * @param {import("../format/streamindex.js").SegmentRecord} record
   * @param {string} part
   */
  async #fetch(record, part) {
    try {
      const packets = await this.stream.object(record, part, (numBytes) => {
        this.comeBytes += numBytes;
        this.onNews();
      });
      await handOver(this.stream.manifest, record, part, packets, this.sink);
    } catch (error) {
      if (!this.isClosed) this.failure ??= error;
    }
    this.onNews();
  }

  close() {
    this.isClosed = true;
    this.stream.rateBps = this.rateBps ?? this.stream.rateBps;
  }
}
