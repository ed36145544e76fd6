import { corrupt } from "../format/bytes/errors.js";
import { checkGaussians, readManifest } from "../format/manifest.js";
import { inflatePacket, isGzip, limitBytes } from "../format/packet.js";
import { SourceError } from "./fetcher.js";
import { begunPlay, GoneError, Patience } from "./playresponse.js";

/** A response is not read on while so much is here that has not shown: a server may not fill memory. */
const MOST_AHEAD_S = 20;
/** Seconds from one word to the server of how the play stands to the next. */
const NEWS_S = 1;

/** @typedef {import("./source.js").Sink} Sink */
/** @typedef {import("./playresponse.js").PlayResponse} PlayResponse */

/** A path that names a stream of a swings server. */
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

/** A stream of a swings server, which chooses itself what it sends when. */
export class ServedStream {
  /**
   * @param {string} base
   * @param {import("./fetcher.js").Fetcher} fetcher
   * @param {import("./playresponse.js").BegunPlay} first
   */
  constructor(base, fetcher, first) {
    this.base = base;
    this.fetcher = fetcher;
    this.manifest = readManifest(first.start.manifest);
    this.numFrames = first.start.numFrames;
    /** @type {PlayResponse | null} for the play that begins where it does */
    this.first = first.response;
    /** @type {string | null} of the last play: the server knows the link from there */
    this.lastToken = first.response.token;
    /** @type {number | null} what the server took the link to carry when it last said so */
    this.rateBps = null;
    this.onGrown = () => {};
  }

  /**
   * Begins to play from the first frame on; waits for the first frames of a live stream. Rejects with
   * a SourceError or a FormatError.
   * @param {string} base URL of the stream, with a slash at its end
   * @param {import("./fetcher.js").Fetcher} fetcher
   * @param {number | null} maxGaussians see `checkGaussians`
   */
  static async open(base, fetcher, maxGaussians = null) {
    const patience = new Patience(fetcher, base);
    for (;;) {
      // Until it is known whether it plays, it does not.
      const nothing = { layers: null, lastToken: null, rateBps: null, nextFrame: null };
      const wish = { ...nothing, fromFrame: 0, paused: true };
      const stream = new ServedStream(
        base,
        fetcher,
        await patience.begin(() => begunPlay(base, wish)),
      );
      try {
        checkGaussians(stream.manifest, maxGaussians, base);
      } catch (error) {
        stream.first?.close();
        throw error;
      }
      if (stream.numFrames > 0) return stream;
      stream.first?.close();
      if (!stream.manifest.live) throw new SourceError(`${base} ended before its first frame`);
      fetcher.onTrouble("This stream has no frames yet; it starts when the first frames arrive");
      await new Promise((resolve) => setTimeout(resolve, 1000 * NEWS_S));
    }
  }

  /**
   * @param {Sink} sink
   * @param {import("./source.js").Wish} wish
   */
  play(sink, wish) {
    return new ServedPlay(this, sink, wish);
  }

  /** Its plays see it grow. @param {() => void} onGrown */
  async follow(onGrown) {
    this.onGrown = onGrown;
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
   * @param {Sink} sink
   * @param {import("./source.js").Wish} wish
   */
  constructor(stream, sink, { firstFrame, continues, mostLayers, nowS }) {
    this.stream = stream;
    this.sink = sink;
    this.continues = continues;
    this.mostLayers = mostLayers;
    this.nowS = nowS;
    this.firstFrame = firstFrame;
    /** Behind the last slice whose layer 0 is here. */
    this.endBirth = firstFrame;
    this.nextFrame = firstFrame;
    this.paused = false;
    this.toldS = -Infinity;
    /** @type {number | null} what the server takes the link to carry */
    this.rateBps = null;
    /** @type {unknown} */
    this.failure = null;
    this.isClosed = false;
    /** @type {() => void} called when something has come or failed */
    this.onNews = () => {};
    /** @type {PlayResponse | null} */
    this.response = null;
    this.moveOn = () => {};
    this.patience = new Patience(stream.fetcher, stream.base);
    const failed = (/** @type {unknown} */ error) => {
      if (this.isClosed) return;
      this.failure = error;
      this.onNews();
    };
    // Once it has been told where playback is.
    Promise.resolve()
      .then(() => this.#run())
      .catch(failed);
  }

  step() {
    return NEWS_S;
  }

  /**
   * The server hears of it now and then.
   * @param {number} frame
   * @param {boolean} paused
   */
  told(frame, paused) {
    this.nextFrame = frame;
    this.moveOn();
    const nowS = this.nowS();
    if (paused === this.paused && nowS - this.toldS < NEWS_S) return;
    this.paused = paused;
    this.toldS = nowS;
    this.#tell();
  }

  async #tell() {
    const token = this.response?.token;
    if (!token) return;
    const body = JSON.stringify({ frame: this.nextFrame, paused: this.paused });
    try {
      const answer = await fetch(`${this.stream.base}play/${token}`, { method: "POST", body });
      const rateBps = Number(answer.headers.get("Swings-Rate"));
      if (rateBps > 0) this.rateBps = this.stream.rateBps = rateBps;
    } catch {
      // The response says soon enough that the server is gone.
    }
  }

  async #run() {
    const { stream, patience } = this;
    while (!this.isClosed) {
      const { endBirth } = this;
      this.continues ||= endBirth > this.firstFrame;
      this.response = await this.#begin();
      if (this.isClosed) this.response.close();
      this.toldS = -Infinity; // so that the next word goes to this response
      try {
        if (await this.#takeAll(this.response)) return;
      } catch (error) {
        if (!(error instanceof GoneError)) throw error;
      }
      stream.lastToken = this.response.token;
      if (!stream.manifest.live && this.endBirth >= stream.numFrames) return;
      // A server that answers and then breaks off may do so for ever.
      if (this.endBirth > endBirth) patience.reset();
      else await patience.wait();
    }
  }

  /** The response that brings what is not here. */
  async #begin() {
    const { stream, endBirth, mostLayers } = this;
    const { first, base, lastToken, rateBps } = stream;
    stream.first = null;
    const layers = mostLayers < stream.manifest.numLayers ? mostLayers : null;
    if (first !== null && endBirth === 0 && layers === null) return first;
    first?.close();
    const paused = this.paused && endBirth === this.nextFrame;
    // The first slice of a segment is not sent to who begins with it, but is what others go on with.
    const fromFrame = this.continues ? Math.max(0, endBirth - 1) : endBirth;
    // Else the server would send a whole lead beyond the one that is here.
    const nextFrame = this.continues ? this.nextFrame : null;
    const wish = { fromFrame, layers, lastToken, rateBps, paused, nextFrame };
    const { response, start } = await this.patience.begin(() => begunPlay(base, wish));
    stream.grow(start.numFrames, stream.manifest.live);
    return response;
  }

  /**
   * Hands over all that a response brings; gives whether nothing more will come.
   * @param {PlayResponse} response
   */
  async #takeAll(response) {
    const { stream } = this;
    for (;;) {
      const record = await response.next((numBytes) => (stream.fetcher.receivedBytes += numBytes));
      if (this.isClosed) return true;
      if (record === null) return false;
      if (record.kind === "end") {
        stream.grow(record.numFrames, false);
        this.onNews();
        return true;
      }
      if (record.kind === "error") {
        this.patience.why = `The server reports: ${record.message}`;
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
      throw corrupt(`play: the slice born at ${birth} arrived, but birth ${this.endBirth} is next`);
    }
    if (!isSnapshot && record.mask !== null) {
      sink.addMask(birth, await chunkOf(record.mask, limitBytes(manifest, "masks")));
    }
    for (const [n, packet] of record.packets.entries()) {
      const layer = record.firstLayer + n;
      if (layer >= manifest.numLayers)
        throw corrupt(
          `play: a packet of layer ${layer}, but the stream has ${manifest.numLayers} layers`,
        );
      const part = isSnapshot ? `snapshot-${layer}` : `${layer}`;
      const chunk = await chunkOf(packet, limitBytes(manifest, part));
      if (isSnapshot) sink.addSnapshot(birth, layer, chunk);
      else sink.addChange(birth, layer, chunk);
    }
    if (isSnapshot || record.firstLayer > 0) return;
    this.endBirth = Math.max(this.endBirth, birth + 1);
    stream.grow(this.endBirth, manifest.live);
  }

  /** Waits while too much is here that has not shown. */
  async #room() {
    const { fps, segmentFrames } = this.stream.manifest;
    const most = MOST_AHEAD_S * fps + segmentFrames;
    while (!this.isClosed && this.endBirth > this.nextFrame + most) {
      await new Promise((resolve) => (this.moveOn = () => resolve(undefined)));
    }
  }

  close() {
    this.isClosed = true;
    this.patience.isOver = true;
    this.moveOn();
    this.stream.lastToken = this.response?.token ?? this.stream.lastToken;
    this.response?.close();
  }
}

/**
 * @param {Uint8Array} packet as it comes: of coder gzip, or what is in one of coder zstd
 * @param {number} most bytes
 */
async function chunkOf(packet, most) {
  if (isGzip(packet)) return inflatePacket(packet, most);
  if (packet.length > most)
    throw corrupt(`play: a chunk has ${packet.length} bytes, but at most ${most} are allowed`);
  return packet;
}
