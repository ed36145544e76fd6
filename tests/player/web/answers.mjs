/**
 * Answers questions with the code of player/web, for the tests: one JSON object a line in, one out.
 * Bytes and floats travel as hexadecimal.
 */
import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";

import { makeSizes, Media, streamMedia } from "../../../player/web/delivery/media.js";
import { PlaySession } from "../../../player/web/delivery/session.js";
import { copyRows, emptyScene, Scene } from "../../../player/web/feed/scene.js";
import { decodeChunk } from "../../../player/web/format/chunk.js";
import { FormatError } from "../../../player/web/format/bytes/errors.js";
import { readManifest } from "../../../player/web/format/manifest.js";
import { openSource } from "../../../player/web/source/source.js";
import { readObject } from "../../../player/web/format/objecttable.js";
import { inflatePacket } from "../../../player/web/format/packet.js";
import { RecordParser } from "../../../player/web/format/playrecord.js";
import { SlotDecoder } from "../../../player/web/format/slots/slotdecoder.js";
import { SlotLayout } from "../../../player/web/format/slots/slotlayout.js";
import { EMPTY, ON_LATTICE, UNKNOWN } from "../../../player/web/format/slots/slots.js";
import { Fetcher, SourceError } from "../../../player/web/source/fetcher.js";
import { GrowingIndex } from "../../../player/web/source/growingindex.js";
import { handOver, HostedPlay } from "../../../player/web/source/hosted.js";
import { edgeFrame, followPeriodS, isBehind } from "../../../player/web/source/liveedge.js";
import { Playback } from "../../../player/web/playback/playback.js";
import { SlicePlay } from "../../../player/web/playback/sliceplay.js";
import { SlotPlay } from "../../../player/web/playback/slotplay.js";
import { DepthOrder } from "../../../player/web/renderer/depthorder.js";
import { middleOf, sideBySide } from "../../../player/web/stereo/eyes.js";
import { Placement } from "../../../player/web/stereo/placement.js";
import { pinholeOf, poseOfTransform } from "../../../player/web/stereo/xrview.js";
import { Orbit } from "../../../player/web/view/orbit.js";
import { poseOf, worldToCamera } from "../../../player/web/view/pose.js";
import { readIndex } from "../../../player/web/format/streamindex.js";
import { opacityLogits } from "../../../player/web/format/opacity.js";

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
    for (const [layer, slots] of decoder.lanes[lane].entries()) {
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
  const play = manifest.layout === null ? new SlicePlay(manifest) : new SlotPlay(manifest);
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
      const { packets } = readObject(bytes, manifest.version);
      await handOver(manifest, record, part, packets, play);
    }
    const isThere = frame === first ? play.has(frame) : play.hasSlice(frame);
    if (!isThere) throw new Error(`frame ${frame} is not there`);
    const isJoin = frame === first;
    yield { frame, isJoin, updates: isJoin ? play.join(frame) : play.advance(frame) };
  }
}

/** @type {Record<string, (question: any) => unknown>} */
const ANSWERS = {
  chunk({ bytes }) {
    const { gaussians, startOffsets, ...rest } = decodeChunk(unhex(bytes));
    return { ...rest, arrays: Object.values(gaussians).map(hex), startOffsets: hex(startOffsets) };
  },
  object({ bytes, version }) {
    const { coder, packets } = readObject(unhex(bytes), version);
    return { coder, packets: [...packets].map(([birth, packet]) => [birth, hex(packet)]) };
  },
  async packet({ bytes, limit }) {
    return hex(await inflatePacket(unhex(bytes), limit));
  },
  manifest({ bytes }) {
    return readManifest(unhex(bytes));
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
  layout({ swinSize, segmentFrames, shDegree, slots, lattices, numLayers }) {
    const layout = new SlotLayout(swinSize, segmentFrames, shDegree, slots, lattices);
    decoder = new SlotDecoder(layout, numLayers ?? undefined);
    return null;
  },
  load({ bytes }) {
    return decoder.load(unhex(bytes));
  },
  apply({ birth, mask, changes }) {
    const { lane, rows } = decoder.apply(birth, optional(mask), changes.map(optional));
    return { lane, rows: rows.map((of) => [...of]) };
  },
  late({ birth, layer, bytes }) {
    return decoder.late(birth, layer, unhex(bytes));
  },
  held,
  /** The means of what shows in each frame from `first` on, farthest first for the default camera. */
  /** What a play holds at each "look" among its events, see tests/support/slots/arrivals.py. */
  arrivals({ events }) {
    const { layout } = decoder;
    const play = new SlotPlay(/** @type {any} */ ({ layout }));
    const found = [];
    for (const [kind, frame, layer, bytes] of events) {
      if (kind === "mask") play.addMask(frame, unhex(bytes));
      else if (kind === "change") play.addChange(frame, layer, unhex(bytes));
      else if (kind === "snapshot") play.addSnapshot(frame, layer, unhex(bytes));
      else if (kind === "join") play.join(frame);
      else if (kind === "show") play.advance(frame);
      else {
        decoder = play.decoder;
        found.push(held());
      }
    }
    if (play.refused > 0) throw new Error(`${play.refused} chunks were refused`);
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
      media: streamMedia(manifest, records),
      /** @type {import("../../../player/web/source/hosted.js").HostedStream["object"]} */
      async object({ segment }, part, onBytes) {
        const bytes = unhex(files[`segments/${segment}/${part}`]);
        asked.push(`${segment}/${part}`);
        onBytes(bytes.length);
        return readObject(bytes, manifest.version).packets;
      },
    };
    const slicePlay = new SlicePlay(manifest);
    let nowS = 0;
    const wish = {
      firstFrame: 0,
      continues: false,
      mostLayers: manifest.numLayers,
      nowS: () => nowS,
    };
    const play = new HostedPlay(/** @type {any} */ (stream), slicePlay, wish);
    const last = records[records.length - 1];
    for (let frame = 0; frame < last.firstFrame + last.numFrames; frame++) {
      nowS = frame / manifest.fps;
      play.told(frame, false);
      play.step();
    }
    return asked;
  },
  /**
   * The Gaussians that show in every frame of `looks`, to one who looks only then: all arrays of a
   * Gaussian, one behind the other. Then all is played once more, for who looks at the last frame.
   */
  async fed({ files, first, looks }) {
    const manifest = readManifest(unhex(files["manifest.json"]));
    const { numGs, shDegree, layout } = manifest;
    const scene = new Scene(numGs, shDegree, layout?.lattices ?? []);
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
  sizes({ manifest, bytes }) {
    const read = readManifest(unhex(manifest));
    return streamMedia(read, readIndex(unhex(bytes), read)).segments;
  },
  /** Opens the stream at a URL; the memory of this process is told too, in MB. */
  async open({ url, maxGaussians }) {
    const stream = await openSource(url, new Fetcher(), maxGaussians);
    if ("first" in stream) stream.first?.close();
    // Not resourceUsage(), which counts what the parent had when it forked.
    const found = /VmHWM:\s+(\d+)/.exec(readFileSync("/proc/self/status", "utf8"));
    return { numGs: stream.manifest.numGs, peakMb: Number(found?.[1]) / 1024 };
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
  /** Where a stream of each of these lengths is joined, and what shows too late. */
  edges({ fps, segmentFrames, lengths }) {
    const shape = { fps, segmentFrames };
    return lengths.map((/** @type {number} */ numFrames) => {
      const edge = edgeFrame(shape, numFrames);
      const behind = Array.from({ length: numFrames }, (_, n) => isBehind(shape, numFrames, n));
      return { edge, periodS: followPeriodS(shape), behind: behind.lastIndexOf(true) };
    });
  },
  /** What a playback shows of a stream that grows and ends, of which all that there is has come. */
  growing({ fps, numFrames, firstFrame, events }) {
    const play = {
      has: (/** @type {number} */ frame) => frame < playback.numFrames,
      hasSlice: (/** @type {number} */ frame) => frame < playback.numFrames,
      join: () => [],
      advance: () => [],
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
  /** What a session decides to which the same happens as to one of the package. */
  replay({ shape, segments, firstFrame, untilFrame, rateBps, events }) {
    const media = new Media(shape);
    media.segments = segments.map((/** @type {number[][]} */ of) =>
      makeSizes(of[0], of[1], of[2], of[3]),
    );
    media.numFrames = shape.numFrames;
    media.live = shape.live;
    const session = new PlaySession(media, 0, { firstFrame, untilFrame, rateBps });
    const decisions = [];
    for (const [what, ...args] of events) {
      if (what === "grown") Object.assign(media, { numFrames: args[0], live: args[1] });
      else if (what === "told") session.told(args[0], args[1], args[2]);
      else if (what === "acknowledge") session.acknowledge(args[0], args[1]);
      else if (what === "sent") session.sent(args[0], args[1], args[2]);
      else decisions.push([session.decide(args[0]), session.rateBps, session.nextFrame]);
    }
    return decisions;
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
