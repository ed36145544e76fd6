/**
 * Answers questions with the code of player/web, for the tests: one JSON object a line in, one out.
 * Bytes and floats travel as hexadecimal.
 */
import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";

import { copyRows, emptyScene, Scene } from "../../../player/web/feed/scene.js";
import { FormatError } from "../../../player/web/format/bytes/errors.js";
import { readManifest } from "../../../player/web/format/manifest.js";
import { openSource } from "../../../player/web/source/source.js";
import { readObject } from "../../../player/web/format/objecttable.js";
import { inflatePacket } from "../../../player/web/format/packet.js";
import { RecordParser } from "../../../player/web/format/playrecord.js";
import { SlotDecoder } from "../../../player/web/format/slots/slotdecoder.js";
import { passingDecoder } from "../../../player/web/format/slots/passing.js";
import { passingDecoder as bundledDecoder } from "../../../player/web/bundle/passing.js";
import { SlotLayout } from "../../../player/web/format/slots/slotlayout.js";
import { EMPTY, ON_LATTICE, UNKNOWN } from "../../../player/web/constants.js";
import { shareAt, Smoothing } from "../../../player/web/element/smoothing.js";
import { RateEstimator } from "../../../player/web/source/estimator.js";
import { Fetcher, SourceError } from "../../../player/web/source/fetcher.js";
import { GrowingIndex } from "../../../player/web/source/growingindex.js";
import { HostedStream } from "../../../player/web/source/hosted.js";
import { HostedPlay } from "../../../player/web/source/hostedplay.js";
import { LayerRule } from "../../../player/web/source/layerrule.js";
import { SegmentCache } from "../../../player/web/source/segmentcache.js";
import { edgeFrame, followPeriodS, isBehind } from "../../../player/web/source/liveedge.js";
import { Playback } from "../../../player/web/playback/playback.js";
import { ChunkFeed } from "../../../player/web/playback/chunkfeed.js";
import { Scrubber } from "../../../player/web/playback/scrubber.js";
import { PendingUpdates } from "../../../player/web/playback/pendingupdates.js";
import { StreamPlay } from "../../../player/web/playback/streamplay.js";
import { DepthOrder } from "../../../player/web/renderer/depthorder.js";
import { floatWords, latticeWords, roomFor } from "../../../player/web/renderer/resident.js";
import { middleOf, sideBySide } from "../../../player/web/stereo/eyes.js";
import { Placement } from "../../../player/web/stereo/placement.js";
import { pinholeOf, poseOfTransform } from "../../../player/web/stereo/xrview.js";
import { readCaptionTracks } from "../../../player/web/captions/captiontracks.js";
import { readCues, textAt } from "../../../player/web/captions/webvtt.js";
import { FetchPace } from "../../../player/web/sound/fetchpace.js";
import { oggOf } from "../../../player/web/sound/ogg.js";
import { checkSpan, readSoundObject } from "../../../player/web/sound/soundobject.js";
import { SoundRun } from "../../../player/web/sound/soundrun.js";
import { heardAt, placeAt, readSources } from "../../../player/web/sound/soundsource.js";
import { SoundTrack } from "../../../player/web/sound/soundtrack.js";
import { stretched } from "../../../player/web/sound/stretch.js";
import { Timeline } from "../../../player/web/sound/timeline.js";
import { Orbit } from "../../../player/web/view/orbit.js";
import { nearOf, poseOf, worldToCamera } from "../../../player/web/view/pose.js";
import { storyboardLayout } from "../../../player/web/format/storyboard.js";
import { readIndex } from "../../../player/web/format/streamindex.js";
import { opacityLogits } from "../../../player/web/format/dequantise.js";

/** @param {ArrayBufferView} array */
const hex = (array) =>
  Buffer.from(array.buffer, array.byteOffset, array.byteLength).toString("hex");
/** @param {string} text */
const unhex = (text) => Uint8Array.from(Buffer.from(text, "hex"));
/** @param {string | null} text */
const optional = (text) => (text === null ? null : unhex(text));

/** @type {SlotDecoder} */
let decoder;
/** @type {GrowingIndex} */
let index;

/** What all slots hold: [lane][layer][slot], see tests/support/slots/plain.py. */
function held() {
  const { layout, frame } = decoder;
  /** @type {unknown[][][]} */
  const lanes = Array.from({ length: layout.swinSize }, () => []);
  for (let birth = (frame ?? 0) - layout.swinSize + 1; birth <= (frame ?? 0); birth++) {
    const lane = layout.lane(birth);
    const shown = decoder.whole(birth).slots ?? decoder.lanes[lane];
    for (const [layer, slots] of shown.entries()) {
      const rows = Uint32Array.from(slots.conditions, (_, i) => i);
      const floats = slots.gaussians(rows, layout.lattices[layer]);
      const widths = [3, 3, 4, 1, 3 * layout.k];
      lanes[lane].push(
        [...rows].map((row) => {
          const condition = slots.conditions[row];
          if (condition === UNKNOWN) return "unknown";
          if (condition === EMPTY) return "empty";
          const bits = Object.values(floats).map((array, i) =>
            hex(array.subarray(widths[i] * row, widths[i] * (row + 1))),
          );
          const width = slots.numAttributes;
          const bytes = slots.attributes.subarray(width * row, width * (row + 1));
          const integers = [
            ...slots.positions.subarray(3 * row, 3 * row + 3),
            ...Int8Array.from(bytes.subarray(0, -1)),
            bytes[width - 1],
          ];
          const start = Math.max(birth + slots.starts[row], frame ?? 0);
          return [start, condition === ON_LATTICE ? integers : null, bits.join("")];
        }),
      );
    }
  }
  return lanes;
}

/**
 * What is new in each frame from `first` on. Of layers above 0 the objects come `lateness` frames after
 * their segment has begun to show.
 * @param {import("../../../player/web/format/manifest.js").Manifest} manifest
 * @param {Record<string, string>} files
 * @param {number} first
 * @param {number} lateness
 */
async function* played(manifest, files, first, lateness) {
  const records = readIndex(unhex(files["index.bin"]), manifest);
  const play = new StreamPlay(manifest);
  const cache = new SegmentCache(manifest);
  const feed = new ChunkFeed(cache, play, manifest, first, manifest.numLayers, 1);
  const last = records[records.length - 1];
  /** @type {[number, import("../../../player/web/format/streamindex.js").SegmentRecord, string][]} */
  const coming = records.flatMap((record) =>
    [...manifest.parts].reverse().map((part) => {
      const isLate = part !== "masks" && !part.endsWith("0");
      return [isLate ? Math.max(first, record.firstFrame) + lateness : 0, record, part];
    }),
  );
  for (let frame = first; frame < last.firstFrame + last.numFrames; frame++) {
    for (const [when, record, part] of coming) {
      if (when !== frame && !(frame === first && when <= first)) continue;
      const bytes = unhex(files[`segments/${record.segment}/${part}`]);
      cache.addObject(record, part, readObject(bytes).packets);
    }
    feed.advance(frame + 1, 1);
    while (feed.isRunning) await new Promise((resolve) => setImmediate(resolve));
    if (feed.failure !== null) throw feed.failure;
    const isThere = frame === first ? play.has(frame) : play.hasSlice(frame);
    if (!isThere) throw new Error(`frame ${frame} is not there`);
    const isJoin = frame === first;
    yield { frame, ...(isJoin ? { isJoin, updates: play.join(frame) } : play.advance(frame)) };
  }
}

/** @type {Record<string, (question: any) => unknown>} */
const ANSWERS = {
  object({ bytes }) {
    const { coder, packets } = readObject(unhex(bytes));
    return { coder, packets: [...packets].map(([birth, packet]) => [birth, hex(packet)]) };
  },
  async packet({ bytes, limit }) {
    return hex(await inflatePacket(unhex(bytes), limit));
  },
  sound({ bytes, channels, span }) {
    const object = readSoundObject(unhex(bytes), channels);
    if (span) checkSpan(object, span[0], span[1]);
    const { preSkip, numSamples, packets, positions } = object;
    return { preSkip, numSamples, positions, packets: packets.map(hex) };
  },
  cues({ text, timeS }) {
    const cues = readCues(text);
    return { cues, text: textAt(cues ?? [], timeS) };
  },
  captions({ captions }) {
    return readCaptionTracks(captions);
  },
  sources({ sound }) {
    return readSources(sound);
  },
  place({ keys, timeS }) {
    return placeAt(keys, timeS);
  },
  heard({ keys, timeS, w2c }) {
    return heardAt(keys, timeS, w2c);
  },
  /**
   * The segments whose sound is asked for and aborted by each of these wants, [second, isFull], of segments
   * of a second: nothing is ever answered.
   */
  async wanted({ wants }) {
    const timeline = new Timeline(30, 30);
    timeline.reach(3000, false);
    /** @type {{ asked: number[], aborted: number[] }} */
    let found = { asked: [], aborted: [] };
    const fetchObject = (
      /** @type {number} */ segment,
      /** @type {string} */ _part,
      /** @type {AbortSignal} */ signal,
    ) => {
      found.asked.push(segment);
      return new Promise((_, reject) =>
        signal.addEventListener("abort", () => {
          found.aborted.push(segment);
          reject(signal.reason);
        }),
      );
    };
    const refuse = (/** @type {unknown} */ error) => {
      throw error;
    };
    const source = { part: "audio-main", channels: 1, keys: [] };
    const track = new SoundTrack(source, timeline, fetchObject, refuse, refuse);
    const all = [];
    for (const [second, isFull] of wants) {
      track.want(timeline.piecesFrom(48000 * second, 5 * 48000, false, 100), 2, isFull);
      await new Promise((resolve) => setImmediate(resolve));
      all.push(found);
      found = { asked: [], aborted: [] };
    }
    track.close();
    await new Promise((resolve) => setImmediate(resolve));
    return [...all, found];
  },
  /** What each step of a run at a rate, 0.1 s apart, hands to the device: [first sample, samples]. */
  handed({ rate, steps }) {
    const timeline = new Timeline(30, 300);
    timeline.reach(3000, false);
    /** @type {number[][]} */
    let found = [];
    const param = { setValueAtTime() {}, setTargetAtTime() {} };
    const context = {
      currentTime: 0,
      createGain: () => ({ gain: param, connect() {} }),
      createBuffer: (/** @type {number} */ _, /** @type {number} */ length) => ({
        length,
        copyToChannel() {},
      }),
      createBufferSource: () => {
        const node = {
          buffer: { length: 0 },
          connect() {},
          start: (/** @type {number} */ atS) =>
            found.push([Math.round(48000 * atS), node.buffer.length]),
        };
        return node;
      },
    };
    const track = {
      samples: (/** @type {number} */ begin) => [
        new Float32Array(timeline.pieceAt(begin).end - begin),
      ],
    };
    const outputs = /** @type {any} */ ([[track, {}]]);
    const run = new SoundRun(/** @type {any} */ (context), timeline, outputs, 0, rate);
    run.setLoops(false, 0);
    const all = [];
    for (let n = 0; n < steps; n++) {
      run.step();
      all.push(found);
      found = [];
      context.currentTime += 0.1;
    }
    return { all, gaps: run.gaps };
  },
  ogg({ packets, ends, channels }) {
    return hex(oggOf(packets.map(unhex), ends, channels));
  },
  stretched({ channels, length }) {
    const given = channels.map((/** @type {number[]} */ one) => Float32Array.from(one));
    return stretched(given, length).map((one) => [...one]);
  },
  pieces({ fps, segmentFrames, numFrames, live, sample, count, loops }) {
    const timeline = new Timeline(fps, segmentFrames);
    timeline.reach(numFrames, live);
    return { length: timeline.length, pieces: timeline.piecesFrom(sample, count, loops, 1000) };
  },
  manifest({ bytes }) {
    return readManifest(unhex(bytes));
  },
  /** Nearest depth drawn from each of these poses, world to camera. */
  nearPlanes({ manifest, poses }) {
    const read = readManifest(unhex(manifest));
    return poses.map((/** @type {number[]} */ w2c) => nearOf(read, { w2c }));
  },
  index({ manifest, bytes }) {
    return readIndex(unhex(bytes), readManifest(unhex(manifest))).map((record) => ({
      ...record,
      psnrDb: hex(Float32Array.from(record.psnrDb)),
      objectSha256: record.objectSha256.map(hex),
    }));
  },
  logits({ levels }) {
    return hex(opacityLogits(levels));
  },
  records({ pieces }) {
    const parser = new RecordParser();
    const found = pieces.flatMap((/** @type {string} */ piece) => parser.feed(unhex(piece)));
    const text = (/** @type {unknown} */ value) =>
      value instanceof Uint8Array ? hex(value) : value;
    return found.map((/** @type {object} */ record) =>
      Object.fromEntries(
        Object.entries(record).map(([key, value]) => [
          key,
          Array.isArray(value) ? value.map(text) : text(value),
        ]),
      ),
    );
  },
  layout({ swinSize, segmentFrames, shDegree, slots, lattices, period, numLayers, isBundled }) {
    const layout = new SlotLayout(swinSize, segmentFrames, shDegree, slots, lattices, period);
    const made = /** @type {typeof passingDecoder} */ (isBundled ? bundledDecoder : passingDecoder);
    if (period > 1) layout.Decoder = made(SlotDecoder, FormatError);
    decoder = new (layout.Decoder ?? SlotDecoder)(layout, numLayers ?? undefined);
    return null;
  },
  load({ bytes }) {
    return decoder.load(unhex(bytes));
  },
  apply({ birth, mask, changes, ahead }) {
    const [next, nextMask, nextChanges] = ahead ?? [0, "", []];
    const slice = decoder.apply(birth, optional(mask), changes.map(optional), {
      masks: new Map(ahead ? [[next, unhex(nextMask)]] : []),
      changes: new Map(ahead ? [[next, nextChanges.map(optional)]] : []),
    });
    const plain = (/** @type {ArrayLike<number>[]} */ layers) => layers.map((of) => Array.from(of));
    return { lane: slice.lane, rows: plain(slice.rows), moves: plain(slice.moves ?? []) };
  },
  late({ birth, layer, bytes }) {
    return decoder.late(birth, layer, unhex(bytes));
  },
  held,
  /** The means of what shows in each frame from `first` on, farthest first for the default camera. */
  /** What a play holds at each "look" among its events, see tests/support/slots/arrivals.py. */
  arrivals({ events }) {
    const { layout } = decoder;
    const play = new StreamPlay(/** @type {any} */ ({ layout }));
    const found = [];
    for (const [kind, frame, layer, bytes] of events) {
      if (kind === "mask") play.addMask(frame, unhex(bytes));
      else if (kind === "change") play.addChange(frame, layer, unhex(bytes));
      else if (kind === "snapshot") play.addSnapshot(frame, layer, unhex(bytes));
      else if (kind === "join") play.join(frame);
      else if (kind === "show") play.advance(frame);
      else if (kind === "state") found.push([play.isLate, play.layers, play.refused]);
      else {
        decoder = play.decoder;
        found.push(held());
      }
    }
    return found;
  },
  async shown({ files, first, lateness }) {
    const manifest = readManifest(unhex(files["manifest.json"]));
    const order = new DepthOrder(manifest.numGs);
    const frames = [];
    for await (const { frame, updates } of played(manifest, files, first, lateness)) {
      for (const { slots, means, starts } of updates) order.put(slots, means, starts);
      const slots = order.farFirst(frame, manifest.defaultCamera.w2c, manifest.nearM);
      frames.push([...slots].map((slot) => hex(order.means.subarray(3 * slot, 3 * slot + 3))));
    }
    return frames;
  },
  /** The objects that a play asks for of a host that has them at once, over a link of this rate. */
  async asked({ files, rateBps }) {
    const manifest = readManifest(unhex(files["manifest.json"]));
    const records = readIndex(unhex(files["index.bin"]), manifest);
    /** @type {string[]} */
    const asked = [];
    const stream = {
      manifest,
      records,
      rateBps,
      cache: new SegmentCache(manifest),
      /** @type {import("../../../player/web/source/hosted.js").HostedStream["object"]} */
      async object({ segment }, part, onBytes) {
        const bytes = unhex(files[`segments/${segment}/${part}`]);
        asked.push(`${segment}/${part}`);
        onBytes(bytes.length);
        return readObject(bytes).packets;
      },
    };
    let nowS = 0;
    const request = { firstFrame: 0, mostLayers: manifest.numLayers, nowS: () => nowS };
    const play = new HostedPlay(/** @type {any} */ (stream), request);
    const last = records[records.length - 1];
    for (let frame = 0; frame < last.firstFrame + last.numFrames; frame++) {
      nowS = frame / manifest.fps;
      play.reportPosition(frame, false, 1);
      play.step();
    }
    return asked;
  },
  /**
   * What a cache holds after each action, and whether it has room for segment 6: [method, ...arguments], in which a number is a packet of so
   * many bytes where one belongs.
   */
  cached({ fps, segmentFrames, numLayers, limitBytes, numFrames, actions }) {
    const shape = /** @type {any} */ ({ fps, segmentFrames, numLayers });
    const cache = new SegmentCache(shape, limitBytes);
    return actions.map((/** @type {any} */ [method, ...args]) => {
      if (method.startsWith("add")) args.push(new Uint8Array(args.pop()));
      /** @type {any} */ (cache)[method](...args);
      const hasRoom = cache.hasRoomFor(6);
      return { ranges: cache.ranges(numFrames), numBytes: cache.numBytes, hasRoom };
    });
  },
  /** What two plays fetch of a host that never answers, and what is aborted once the first is closed. */
  async aborted({ files, frames }) {
    const manifest = files["manifest.json"];
    /** @type {{ name: string, signal: AbortSignal }[]} */
    const asked = [];
    const { fetch } = globalThis;
    globalThis.fetch = async (url, init) => {
      const name = String(url).split("/host/")[1];
      if (name === "manifest.json") return new Response(unhex(manifest));
      if (name === "index.bin") return new Response(unhex(files[name]));
      const signal = /** @type {AbortSignal} */ (init?.signal);
      asked.push({ name, signal });
      return new Promise((_, reject) =>
        signal.addEventListener("abort", () => reject(signal.reason)),
      );
    };
    try {
      const stream = await HostedStream.open("http://any/host/", new Fetcher());
      const plays = frames.map((/** @type {number} */ firstFrame) => {
        const request = { firstFrame, mostLayers: stream.manifest.numLayers, nowS: () => 0 };
        const play = stream.play(request);
        play.step();
        return play;
      });
      plays[0].close();
      await new Promise((resolve) => setTimeout(resolve, 0));
      return {
        asked: asked.map(({ name, signal }) => [name, signal.aborted]),
        failures: plays.map((/** @type {any} */ play) => play.failure),
      };
    } finally {
      globalThis.fetch = fetch;
    }
  },
  /**
   * The segments that a scrubber shows and requests while the thumb moves; each request takes as long
   * as three moves.
   */
  async scrubbed({ files, frames }) {
    const manifest = readManifest(unhex(files["manifest.json"]));
    const cache = new SegmentCache(manifest);
    const records = readIndex(unhex(files["index.bin"]), manifest);
    const { firstFrame, numFrames } = records[records.length - 1];
    /** @type {{ segment: number, answer: () => void, movesLeft: number }[]} */
    const coming = [];
    /** @type {number[]} */
    const asked = [];
    let mostUnderway = 0;
    const fetchSnapshot = (/** @type {number} */ segment) =>
      new Promise((resolve) => {
        asked.push(segment);
        const { packets } = readObject(unhex(files[`segments/${segment}/snapshot-0`]));
        const answer = () => {
          cache.addObject(records[segment], "snapshot-0", packets);
          resolve(true);
        };
        coming.push({ segment, answer, movesLeft: 3 });
        mostUnderway = Math.max(mostUnderway, coming.length);
      });
    const stream = { manifest, cache, numFrames: firstFrame + numFrames, fetchSnapshot };
    /** @type {number[]} */
    const shown = [];
    const scrubber = new Scrubber(
      /** @type {any} */ (stream),
      ({ frame }) => shown.push(frame / manifest.segmentFrames),
      () => {},
    );
    const move = async () => {
      for (const one of coming) one.movesLeft -= 1;
      while (coming[0]?.movesLeft === 0) coming.shift()?.answer();
      // Until it requests the next one or has shown all, however long decoding takes.
      do await new Promise((resolve) => setTimeout(resolve, 0));
      while (scrubber.isRunning && coming.length === 0);
    };
    for (const frame of frames) {
      scrubber.scrub(frame);
      await move();
    }
    for (let n = 0; n < 8; n++) await move();
    return { asked, shown, mostUnderway };
  },
  /**
   * The Gaussians that show in every frame of `looks`, to one who looks only then: all arrays of a
   * Gaussian, one behind the other. Then all is played once more, for who looks at the last frame.
   */
  async fed({ files, first, looks }) {
    const manifest = readManifest(unhex(files["manifest.json"]));
    const { numGs, shDegree, layout } = manifest;
    const scene = new Scene(numGs, shDegree, layout.lattices);
    const seen = emptyScene(numGs, shDegree);
    const look = () => {
      const { slots, gaussians } = scene.take();
      copyRows(
        gaussians,
        (i) => i,
        seen,
        (i) => slots[i],
        slots.length,
      );
      const shows = [...seen.opacities.keys()].filter((slot) => seen.opacities[slot] > 0);
      const gaussian = (/** @type {number} */ slot) =>
        Object.values(seen).map((array) => {
          const width = array.length / numGs;
          return hex(array.subarray(width * slot, width * (slot + 1)));
        });
      return { numNew: slots.length, gaussians: shows.map((slot) => gaussian(slot).join("")) };
    };
    const found = [];
    for await (const shown of played(manifest, files, first, 0)) {
      scene.put(shown);
      if (looks.includes(shown.frame)) found.push(look());
    }
    for await (const shown of played(manifest, files, first, 0)) scene.put(shown);
    return [...found, look()];
  },
  /** The default camera as a person has moved it. */
  moved({ manifest, widthPx, heightPx, moves, again }) {
    const read = readManifest(unhex(manifest));
    let orbit = new Orbit(read);
    for (const [what, ...args] of moves) {
      if (what === "turn") orbit.dragTurn(args[0], args[1]);
      else if (what === "pan") orbit.dragPan(args[0], args[1], args[2]);
      else orbit.approach(args[0]);
    }
    if (again) {
      const { text } = orbit;
      orbit = new Orbit(read);
      orbit.text = text;
    }
    return orbit.camera(read.defaultCamera, widthPx, heightPx);
  },
  /** Both eyes, and the pose in their middle. */
  eyes({ camera, eyeDistanceM, focusM }) {
    const { views } = sideBySide(camera, eyeDistanceM, focusM);
    const middle = middleOf(views.map((view) => poseOf(view.camera)));
    return { views, middle: worldToCamera(middle) };
  },
  /** The camera of an XRView, in a space that lies so in the world that `head` comes to `start`. */
  eye({ head, start, up, transform, projection, widthPx, heightPx }) {
    const placement = new Placement(poseOfTransform(head), poseOf({ w2c: start }), up);
    const pose = placement.pose(poseOfTransform(transform));
    return { ...pinholeOf(projection, widthPx, heightPx), w2c: worldToCamera(pose) };
  },
  middle({ w2cs }) {
    return worldToCamera(middleOf(w2cs.map((/** @type {number[]} */ w2c) => poseOf({ w2c }))));
  },
  /** Opens the stream at a URL; the memory of this process is told too, in MB. */
  async open({ url, maxGaussians }) {
    const stream = await openSource(url, new Fetcher(), maxGaussians);
    if ("first" in stream) stream.first?.close();
    // Not resourceUsage(), which counts what the parent had when it forked.
    const found = /VmHWM:\s+(\d+)/.exec(readFileSync("/proc/self/status", "utf8"));
    return { numGs: stream.manifest.numGs, peakMb: Number(found?.[1]) / 1024 };
  },
  /** How many bytes the first object of the hosted stream at a URL was fetched with. */
  /** The objects of a stream as they come, and the other files of a packed one but manifest and index. */
  async allObjects({ url }) {
    try {
      const stream = /** @type {HostedStream} */ (
        await openSource(url, new Fetcher({ giveUpS: 2 }))
      );
      /** @type {Record<string, string>} */
      const found = {};
      for (const record of stream.records) {
        for (const part of stream.manifest.parts) {
          const { bytes } = await stream.objectBytes(record, part, () => {});
          found[`segments/${record.segment}/${part}`] = Buffer.from(bytes).toString("hex");
        }
      }
      const files = await Promise.all(
        Object.entries(stream.files ?? {}).map(async ([path, place]) => {
          const { bytes } = await stream.fetcher.range(stream.base, place);
          return [path, Buffer.from(bytes).toString("hex")];
        }),
      );
      return { found, files: Object.fromEntries(files) };
    } catch (error) {
      if (error instanceof SourceError) return { failed: error.message };
      throw error;
    }
  },

  async firstObject({ url, otherHosts }) {
    const stream = /** @type {HostedStream} */ (
      await openSource(url, new Fetcher(), null, otherHosts)
    );
    let numBytes = 0;
    try {
      await stream.object(stream.records[0], stream.manifest.parts[0], (n) => (numBytes += n));
    } catch (error) {
      if (error instanceof SourceError) return { failed: error.message };
      throw error;
    }
    return { numBytes };
  },
  /** The index at a URL, as far as it has come; the same one again without a URL. */
  async refresh({ url, manifest }) {
    if (url) index = new GrowingIndex(url, new Fetcher(), readManifest(unhex(manifest)));
    const beforeBytes = index.fetcher.receivedBytes;
    try {
      const fresh = (await index.refresh()).map(({ segment }) => segment);
      const numBytes = index.fetcher.receivedBytes - beforeBytes;
      return { fresh, known: index.records.length, numBytes };
    } catch (error) {
      if (error instanceof SourceError) return { failed: error.message };
      throw error;
    }
  },
  /** What a rule asks for as things stand one after another, until nothing is worth it. */
  chosen({ manifest, index, firstFrame, mostLayers, standings }) {
    const read = readManifest(unhex(manifest));
    const records = readIndex(unhex(index), read);
    const rule = new LayerRule(read, records, firstFrame, mostLayers);
    return standings.map((/** @type {any} */ standing) => {
      const asked = [];
      for (let left = 1000; left > 0; left--) {
        const segment = rule.choose(standing);
        if (segment === null) return asked;
        for (const part of rule.parts(segment)) asked.push(`${segment}/${part}`);
        rule.add(segment);
      }
      throw new Error("the rule asks for ever");
    });
  },
  /** What an estimator says after each sample. */
  estimates({ samples }) {
    const estimator = new RateEstimator();
    return samples.map((/** @type {[number, number]} */ [bytes, busyS]) => {
      estimator.add(bytes, busyS);
      return estimator.rateBps;
    });
  },
  /** Layouts of storyboards. */
  storyboards({ streams }) {
    return streams.map((/** @type {[number, number]} */ [numFrames, fps]) =>
      storyboardLayout(numFrames, fps),
    );
  },
  /** Where a stream of each of these lengths is joined, and what shows too late. */
  edges({ fps, segmentFrames, lengths }) {
    const shape = { fps, segmentFrames };
    return lengths.map((/** @type {number} */ numFrames) => {
      const edge = edgeFrame(shape, numFrames);
      const behind = Array.from({ length: numFrames }, (_, n) => isBehind(shape, numFrames, n));
      return { edge, periodS: followPeriodS(shape), behind: behind.lastIndexOf(true) };
    });
  },
  /**
   * What a renderer's slots hold that is given only now and then what is new. `updates`: of each the
   * [slot, value] on the lattice and as floats, and whether all is handed over after it.
   */
  pending({ numSlots, shDegree, updates }) {
    const pending = new PendingUpdates(numSlots, shDegree);
    const widths = { lattice: latticeWords(shDegree), floats: floatWords(shDegree) };
    const slotWords = { lattice: 3, floats: 0 };
    const values = new Array(numSlots).fill(0);
    let mostEntries = 0;
    for (const { isHanded, ...update } of updates) {
      const [none, frame] = [new Uint32Array(0), 0];
      const words = { frame, lattice: none, floats: none, leaving: none };
      for (const kind of /** @type {const} */ (["lattice", "floats"])) {
        words[kind] = roomFor(update[kind].length, widths[kind]);
        for (const [i, [slot, value]] of update[kind].entries()) {
          const first = i * widths[kind];
          words[kind].fill(value, first, first + widths[kind]);
          words[kind][first + slotWords[kind]] = slot;
        }
      }
      pending.add(words);
      mostEntries = Math.max(mostEntries, pending.numEntries);
      if (!isHanded) continue;
      for (const taken of pending.take()) {
        for (const kind of /** @type {const} */ (["lattice", "floats"])) {
          const width = widths[kind];
          for (let first = 0; first + width <= taken[kind].length; first += width) {
            const entry = taken[kind].subarray(first, first + width);
            values[entry[slotWords[kind]]] = entry[width - 1];
          }
        }
      }
    }
    return { values, mostEntries };
  },
  /** How much of the way to each [frame] is over at each [ms]. */
  shares({ line, fps, numFrames, moments }) {
    return moments.map((/** @type {[number, number]} */ [nowMs, frame]) =>
      shareAt(nowMs, line, frame, fps, numFrames),
    );
  },
  /**
   * Whether a view shows motion before each picture, of a screen and a stream with so many pictures and
   * frames a second; `busyMs`: how much later than it could each picture is drawn.
   */
  smoothed({ screenHz, fps, busyMs, count, interpolates, paused, moves }) {
    const renderer = { inbetween: { share: 1, isMoving: moves } };
    const line = {
      zeroMs: /** @type {number | null} */ (performance.timeOrigin),
      rate: 1,
      line: 1,
    };
    const [pausedFrom, pausedTo] = paused;
    let zeroMs = 0;
    let isAsked = false;
    const view = {
      session: { line, numFrames: 1000 },
      manifest: { fps, numGs: 1 },
      painter: { renderer },
      headset: null,
      interpolates,
      isEmpty: false,
      needsDrawing: false,
      shownFrame: 0,
      loop: { request: () => (isAsked = true) },
    };
    const smoothing = new Smoothing(/** @type {any} */ (view));
    const found = [];
    let nowMs = 0;
    for (let n = 0; n < count; n++) {
      if (n === pausedFrom) line.zeroMs = null;
      if (n === pausedTo) {
        zeroMs = nowMs - (1000 * view.shownFrame) / fps; // the frame that stands has its whole time
        line.zeroMs = performance.timeOrigin + zeroMs;
      }
      if (line.zeroMs !== null)
        view.shownFrame = Math.floor(((nowMs - zeroMs) / 1000) * fps + 1e-6);
      view.needsDrawing = false;
      isAsked = false;
      const isMoving = smoothing.step(nowMs);
      if (isMoving && !isAsked) throw new Error("the next picture is asked for while it moves");
      const { needsDrawing: draws, shownFrame: frame } = view;
      found.push({ nowMs, isMoving, isAsked, draws, frame, share: renderer.inbetween.share });
      // While nothing moves, pictures come with frames.
      const frameMs = zeroMs + (1000 * (view.shownFrame + 1)) / fps;
      const nextMs = isAsked ? nowMs + 1 : Math.max(nowMs + 1, frameMs);
      const stepMs = 1000 / screenHz;
      nowMs = Math.ceil((nextMs + busyMs[n % busyMs.length]) / stepMs) * stepMs;
    }
    return found;
  },
  /**
   * What a feed of sound does whose segments of `lengthMs` each take `tookMs`, and are played from the
   * first one on: when each was asked for and came, and when it is due.
   */
  paced({ lengthMs, aheadMs, tookMs, rounds }) {
    const pace = new FetchPace();
    const found = [];
    for (let nowMs = 0; nowMs < rounds * lengthMs; ) {
      const playedMs = Math.max(0, nowMs - tookMs);
      const dueMs = Math.max(0, found.length * lengthMs - playedMs);
      if (dueMs < Math.max(aheadMs, lengthMs) && pace.allows(dueMs, nowMs)) {
        pace.fetched(nowMs, nowMs + tookMs, lengthMs);
        found.push([nowMs, nowMs + tookMs, found.length * lengthMs + tookMs]);
        nowMs += tookMs;
      } else nowMs += 0.01 * lengthMs;
    }
    return found;
  },
  /** What a playback shows of a stream that grows and ends, of which all that there is has come. */
  growing({ fps, numFrames, firstFrame, events }) {
    const play = {
      has: (/** @type {number} */ frame) => frame < playback.numFrames,
      canAdvance: (/** @type {number} */ frame) => frame < playback.numFrames,
      join: () => [],
      advance: () => ({ isJoin: false, updates: [] }),
    };
    const playback = new Playback(/** @type {any} */ (play), fps, numFrames, firstFrame);
    playback.live = true;
    playback.setPlaying(true);
    const found = [];
    for (const [nowS, numFrames, live] of events) {
      Object.assign(playback, { numFrames, live });
      const shown = playback.tick(nowS);
      const { frame, waiting, stalls, hasEnded } = playback;
      found.push({ frame, isNew: shown !== null, waiting, stalls, hasEnded });
    }
    return found;
  },
};

for await (const line of createInterface({ input: process.stdin })) {
  const question = JSON.parse(line);
  let answer;
  try {
    answer = { value: await ANSWERS[question.ask](question) };
  } catch (error) {
    if (!(error instanceof FormatError)) throw error;
    answer = { refused: error.kind, message: error.message };
  }
  process.stdout.write(`${JSON.stringify(answer)}\n`);
}
