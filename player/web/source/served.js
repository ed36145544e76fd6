import { corrupt } from "../format/bytes/errors.js";
import { readManifest } from "../format/manifest.js";
import { inflatePacket, isGzip, limitBytes } from "../format/packet.js";
import { delayS, SourceError } from "./fetcher.js";
import { GoneError, PlayResponse } from "./playresponse.js";

/** A response is not read on while so much is here that has not shown: a server may not fill memory. */
const MOST_AHEAD_S = 20;
/** Seconds from one word to the server of how the play stands to the next. */
const NEWS_S = 1;
/** What shows within so many seconds is not asked for again when the number of layers changes. */
const SOON_S = 0.5;

/** @typedef {import("../format/playrecord.js").StartRecord} StartRecord */

/** A stream of a swings server, which chooses itself what it sends when. */
export class ServedStream {
  /**
   * @param {string} base URL of the stream, with a slash at its end
   * @param {import("./fetcher.js").Fetcher} fetcher
   * @param {PlayResponse} response that has said how it starts
   * @param {StartRecord} start
   */
  constructor(base, fetcher, response, start) {
    this.base = base;
    this.fetcher = fetcher;
    this.manifest = readManifest(start.manifest);
    this.numFrames = start.numFrames;
    /** @type {PlayResponse | null} for the play that begins where it does */
    this.first = response;
    /** @type {string | null} of the last play: the server knows the link from there */
    this.lastToken = response.token;
    /** @type {() => void} called when there are more frames, or never will be */
    this.onGrown = () => {};
  }

  /**
   * Begins to play from the first frame on. Rejects with a SourceError or a FormatError.
   * @param {string} base
   * @param {import("./fetcher.js").Fetcher} fetcher
   */
  static async open(base, fetcher) {
    const wish = { fromFrame: 0, layers: null, lastToken: null };
    const { response, start } = await patiently(fetcher, base, () => begun(base, wish));
    if (start.numFrames === 0) {
      response.close();
      throw new SourceError(`${base} has no frames yet; come back later`);
    }
    return new ServedStream(base, fetcher, response, start);
  }

  /**
   * @param {import("./hosted.js").Sink} sink
   * @param {{ firstFrame: number, mostLayers: number }} wish
   */
  play(sink, wish) {
    return new ServedPlay(this, sink, wish);
  }

  /**
   * Takes in that frames up to `numFrames` are there.
   * @param {number} numFrames
   * @param {boolean} live whether there may be more
   */
  grow(numFrames, live) {
    if (numFrames <= this.numFrames && live === this.manifest.live) return;
    this.numFrames = Math.max(this.numFrames, numFrames);
    this.manifest = { ...this.manifest, live };
    this.onGrown();
  }
}

/** One play of it: whatever comes is handed over, and asked for again when the connection is gone. */
export class ServedPlay {
  /**
   * @param {ServedStream} stream
   * @param {import("./hosted.js").Sink} sink
   * @param {{ firstFrame: number, mostLayers: number }} wish
   */
  constructor(stream, sink, { firstFrame, mostLayers }) {
    this.stream = stream;
    this.sink = sink;
    this.firstFrame = firstFrame;
    this.mostLayers = mostLayers;
    /** Behind the last slice whose layer 0 is here. */
    this.endBirth = firstFrame;
    this.nextFrame = firstFrame;
    this.paused = false;
    this.newsS = -Infinity;
    /** @type {number | null} what the server says that the link carries */
    this.rateBps = null;
    /** @type {unknown} */
    this.failure = null;
    this.isClosed = false;
    /** @type {() => void} called when something has come or failed */
    this.onNews = () => {};
    /** @type {PlayResponse | null} */
    this.response = null;
    /** @type {() => void} */
    this.moveOn = () => {};
    this.#run().catch((error) => {
      if (this.isClosed) return;
      this.failure = error;
      this.onNews();
    });
  }

  /** Gives seconds until it should be called again, at most. */
  step() {
    return NEWS_S;
  }

  /**
   * The playback says where it is; the server hears of it now and then.
   * @param {number} nowS
   * @param {number} frame the next one that it will show
   * @param {boolean} paused
   */
  told(nowS, frame, paused) {
    this.nextFrame = frame;
    this.moveOn();
    if (paused === this.paused && nowS - this.newsS < NEWS_S) return;
    this.paused = paused;
    this.newsS = nowS;
    this.#tell();
  }

  async #tell() {
    const token = this.response?.token;
    if (!token) return;
    const body = JSON.stringify({ frame: this.nextFrame, paused: this.paused });
    try {
      const answer = await fetch(`${this.stream.base}play/${token}`, { method: "POST", body });
      const rateBps = Number(answer.headers.get("Swings-Rate"));
      if (rateBps > 0) this.rateBps = rateBps;
    } catch {
      // The response says soon enough that the server is gone.
    }
  }

  /** Shows this many layers at most, as soon as it can. @param {number} most */
  setLayers(most) {
    const isMore = most > this.mostLayers;
    this.mostLayers = most;
    const soon = this.nextFrame + Math.round(SOON_S * this.stream.manifest.fps);
    if (isMore) this.endBirth = Math.max(this.firstFrame, Math.min(this.endBirth, soon));
    this.response?.close();
  }

  get #isWhole() {
    const { manifest, numFrames } = this.stream;
    return !manifest.live && this.endBirth >= numFrames;
  }

  async #run() {
    while (!this.isClosed) {
      const { stream } = this;
      this.response = await this.#begin();
      try {
        if (await this.#takeAll(this.response)) return;
      } catch (error) {
        if (!(error instanceof GoneError)) throw error;
      }
      stream.lastToken = this.response.token;
      if (this.#isWhole) return;
    }
  }

  /** The response that brings what is not here. */
  async #begin() {
    const { stream, endBirth, mostLayers } = this;
    const { first, manifest, base, fetcher } = stream;
    stream.first = null;
    const layers = mostLayers < manifest.numLayers ? mostLayers : null;
    if (first !== null && endBirth === 0 && layers === null) return first;
    first?.close();
    const wish = { fromFrame: endBirth, layers, lastToken: stream.lastToken };
    const { response, start } = await patiently(
      fetcher,
      base,
      () => begun(base, wish),
      () => this.isClosed,
    );
    stream.grow(start.numFrames, manifest.live);
    return response;
  }

  /**
   * Hands over all that a response brings; gives whether nothing more will come.
   * @param {PlayResponse} response
   */
  async #takeAll(response) {
    const { stream } = this;
    let counted = 0;
    for (;;) {
      const record = await response.next();
      stream.fetcher.receivedBytes += response.receivedBytes - counted;
      counted = response.receivedBytes;
      if (this.isClosed) return true;
      if (record === null) return false;
      if (record.kind === "end") {
        stream.grow(record.numFrames, false);
        this.onNews();
        return true;
      }
      if (record.kind === "error") {
        stream.fetcher.onTrouble(`The server says: ${record.message}`);
        return false;
      }
      if (record.kind !== "start") await this.#take(record);
      this.onNews();
      await this.#room();
    }
  }

  /** @param {import("../format/playrecord.js").SliceRecord | import("../format/playrecord.js").SnapshotRecord} record */
  async #take(record) {
    const { stream, sink } = this;
    const { manifest } = stream;
    const isSnapshot = record.kind === "snapshot";
    const birth = isSnapshot ? record.frame : record.birth;
    // What comes far ahead of layer 0 is of no use, and would stay.
    if (birth > this.endBirth + manifest.segmentFrames) {
      throw corrupt(`play: the slice born at ${birth}, where ${this.endBirth} comes next`);
    }
    if (!isSnapshot && record.mask !== null) {
      sink.addMask(birth, await chunkOf(record.mask, limitBytes(manifest, "masks")));
    }
    for (const [n, packet] of record.packets.entries()) {
      const layer = record.firstLayer + n;
      const part = isSnapshot ? `snapshot-${layer}` : `${layer}`;
      const chunk = await chunkOf(packet, limitBytes(manifest, part));
      if (layer >= manifest.numLayers) continue;
      if (isSnapshot) sink.addSnapshot(birth, layer, chunk);
      else sink.addChange(birth, layer, chunk);
    }
    if (isSnapshot || record.firstLayer > 0) return;
    this.endBirth = Math.max(this.endBirth, birth + 1);
    stream.grow(this.endBirth, manifest.live);
  }

  /** Waits while too much is here that has not shown. */
  async #room() {
    const most = MOST_AHEAD_S * this.stream.manifest.fps + this.stream.manifest.segmentFrames;
    while (!this.isClosed && this.endBirth > this.nextFrame + most) {
      await new Promise((resolve) => (this.moveOn = () => resolve(undefined)));
    }
  }

  close() {
    this.isClosed = true;
    this.moveOn();
    this.stream.lastToken = this.response?.token ?? this.stream.lastToken;
    this.response?.close();
  }
}

/**
 * A response, and how it starts. Rejects as PlayResponse.open does.
 * @param {string} base
 * @param {{ fromFrame: number, layers: number | null, lastToken: string | null }} wish
 */
async function begun(base, wish) {
  const response = await PlayResponse.open(base, wish);
  const start = await response.next();
  if (start === null) throw new GoneError();
  if (start.kind !== "start") throw corrupt("play: the first record does not say how it starts");
  return { response, start };
}

/**
 * Tries again and again while the server is gone. Rejects with a SourceError after a while, and with
 * what else goes wrong.
 * @template T
 * @param {import("./fetcher.js").Fetcher} fetcher
 * @param {string} base
 * @param {() => Promise<T>} action
 * @param {() => boolean} [isOver] whether nobody waits any more
 * @returns {Promise<T>}
 */
async function patiently(fetcher, base, action, isOver = () => false) {
  const beganMs = performance.now();
  for (let tries = 1; ; tries++) {
    let afterS = 0;
    try {
      const result = await action();
      fetcher.onTrouble(null);
      return result;
    } catch (error) {
      if (!(error instanceof GoneError) || isOver()) throw error;
      ({ afterS } = error);
    }
    if (performance.now() - beganMs > 1000 * fetcher.giveUpS) {
      throw new SourceError(`${base} cannot be reached; check the network and try again`);
    }
    fetcher.onTrouble("The server is gone; trying again");
    const restS = Math.max(delayS(tries), Math.min(afterS || 0, fetcher.giveUpS));
    await new Promise((resolve) => setTimeout(resolve, 1000 * restS));
  }
}

/**
 * @param {Uint8Array} packet as it comes: of coder gzip, or what is in one of coder zstd
 * @param {number} most bytes
 */
async function chunkOf(packet, most) {
  if (isGzip(packet)) return inflatePacket(packet, most);
  if (packet.length > most)
    throw corrupt(`play: a chunk of ${packet.length} bytes, at most ${most}`);
  return packet;
}

/** A path that names a stream of a swings server, with the name. */
const SERVED_PATH = /^(.*)\/(?:v1\/streams|watch)\/([^/]+)\/?$/;

/**
 * The URL of the stream on a swings server that `url` names, with a slash at its end; null where it
 * is not such an address.
 * @param {string} url
 */
export function servedBase(url) {
  const { origin, pathname } = new URL(url);
  const found = SERVED_PATH.exec(pathname);
  return found === null ? null : `${origin}${found[1]}/v1/streams/${found[2]}/`;
}
