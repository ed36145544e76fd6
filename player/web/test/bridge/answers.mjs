/**
 * Answers questions with the code of player/web, for the tests: one JSON object a line in, one out.
 * Bytes and floats travel as hexadecimal.
 */
import { createInterface } from "node:readline";

import { copyRows, emptyScene, Scene } from "../../feed/scene.js";
import { FormatError } from "../../format/bytes.js";
import { layerOf, readManifest } from "../../format/manifest.js";
import { framePly } from "../../format/ply.js";
import { openSource } from "../../source/source.js";
import { readIndex, readObject } from "../../format/objects.js";
import { packetContent } from "../../format/planes.js";
import { RecordParser } from "../../format/playrecord.js";
import { SlotDecoder } from "../../format/slots/slotdecoder.js";
import { gaussiansOf } from "../../format/dequantise.js";
import { opacityLogits, SlotLayout } from "../../format/gaussians.js";
import { EMPTY, ON_LATTICE, UNKNOWN } from "../../constants.js";
import { fetchRange } from "../../source/files.js";
import { Fetcher, SourceError } from "../../source/fetcher.js";
import { addObject } from "../../source/hosteddownload.js";
import { SegmentCache } from "../../source/segmentcache.js";
import { ChunkFeed, loadPlanes } from "../../playback/playsession.js";
import { FrameAssembler } from "../../playback/frameassembler.js";
import { DepthOrder } from "../../playback/depthorder.js";
import { readCaptionTracks, readCues, textAt } from "../../format/captions.js";
import { checkSpan, oggOf, readSoundObject } from "../../sound/soundobject.js";
import { placeAt, readSources } from "../../sound/soundtrack.js";
import { Timeline } from "../../sound/timeline.js";
import { panBy, TURN_RAD_PER_PX } from "../../view/cameramotion.js";
import { Orbit } from "../../view/orbit.js";
import { nearOf } from "../../view/pose.js";
import { storyboardLayout } from "../../controls/storyboard.js";

await loadPlanes();

/** @param {ArrayBufferView} array */
const hex = (array) =>
  Buffer.from(array.buffer, array.byteOffset, array.byteLength).toString("hex");
/** @param {string} text */
const unhex = (text) => Uint8Array.from(Buffer.from(text, "hex"));
/** @param {string | null} text */
const optional = (text) => (text === null ? null : unhex(text));

/** @type {SlotDecoder} */
let decoder;

/** What all slots hold: [lane][layer][slot], see tests/support/slots/plain.py. */
function held() {
  const { layout, frame } = decoder;
  /** @type {unknown[][][]} */
  const lanes = Array.from({ length: layout.swinSize }, () => []);
  for (let birth = (frame ?? 0) - layout.swinSize + 1; birth <= (frame ?? 0); birth++) {
    const lane = layout.lane(birth);
    for (const [layer, slots] of decoder.lanes[lane].entries()) {
      const rows = Uint32Array.from(slots.conditions, (_, i) => i);
      const floats = gaussiansOf(slots, rows, layout.lattices[layer]);
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
 * @param {import("../../format/manifest.js").Manifest} manifest
 * @param {Record<string, string>} files
 * @param {number} first
 * @param {number} lateness
 */
async function* played(manifest, files, first, lateness) {
  const records = readIndex(unhex(files["index.bin"]), manifest);
  const play = new FrameAssembler(manifest);
  const cache = new SegmentCache(manifest);
  const feed = new ChunkFeed(cache, play, manifest, first, manifest.numLayers);
  const last = records[records.length - 1];
  /** @type {[number, import("../../format/objects.js").SegmentRecord, number][]} */
  const coming = records.flatMap((record) =>
    [...manifest.parts.keys()].reverse().map((part) => {
      const isLate = layerOf(manifest, part) > 0;
      return [isLate ? Math.max(first, record.firstFrame) + lateness : 0, record, part];
    }),
  );
  for (let frame = first; frame < last.firstFrame + last.numFrames; frame++) {
    for (const [when, record, part] of coming) {
      if (when !== frame && !(frame === first && when <= first)) continue;
      const bytes = unhex(files[`segments/${record.segment}/${manifest.parts[part]}`]);
      addObject(cache, record, part, readObject(bytes));
    }
    feed.advance(frame + 1, 1);
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
    return [...readObject(unhex(bytes))].map(([birth, packet]) => [birth, hex(packet)]);
  },
  packet({ bytes, limit }) {
    return hex(packetContent(unhex(bytes), limit));
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
  ogg({ packets, ends, channels }) {
    return hex(oggOf(packets.map(unhex), ends, channels));
  },
  /** The samples of each segment of a stream: [first, end). */
  spans({ fps, segmentFrames, numSegments }) {
    const timeline = new Timeline(fps, segmentFrames);
    timeline.reach(segmentFrames * numSegments, false);
    return Array.from({ length: numSegments }, (_, segment) => timeline.span(segment));
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
  layout({ swinSize, segmentFrames, shDegree, slots, lattices, numLayers }) {
    const layout = new SlotLayout(swinSize, segmentFrames, shDegree, slots, lattices);
    decoder = new SlotDecoder(layout, numLayers ?? undefined);
    return null;
  },
  async ply() {
    return hex(new Uint8Array(await framePly(decoder).arrayBuffer()));
  },
  load({ bytes }) {
    return decoder.load(unhex(bytes));
  },
  apply({ birth, skipMap, changes }) {
    const slice = decoder.apply(birth, optional(skipMap), changes.map(optional), true);
    const plain = (/** @type {ArrayLike<number>[]} */ layers) => layers.map((of) => Array.from(of));
    return { lane: slice.lane, rows: plain(slice.rows), moves: plain(slice.moves ?? []) };
  },
  late({ birth, layer, bytes }) {
    return decoder.late(birth, layer, unhex(bytes));
  },
  held,
  /** What a play holds at each "look" among its events, see tests/support/slots/arrivals.py. */
  arrivals({ events }) {
    const { layout } = decoder;
    const play = new FrameAssembler(/** @type {any} */ ({ layout }));
    const found = [];
    for (const [kind, frame, layer, bytes] of events) {
      if (kind === "skip_map") play.addSkipMap(frame, unhex(bytes));
      else if (kind === "change") play.addChange(frame, layer, unhex(bytes));
      else if (kind === "keyframe") play.addKeyframe(frame, layer, unhex(bytes));
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
  /** The means of what shows in each frame from `first` on, farthest first for the default camera. */
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
      if (what === "turn") orbit.turn(-TURN_RAD_PER_PX * args[0], -TURN_RAD_PER_PX * args[1]);
      else if (what === "pan") panBy(orbit, args[0], args[1], args[2]);
      else orbit.scale(0.9 ** args[0]);
    }
    if (again) {
      const { text } = orbit;
      orbit = new Orbit(read);
      orbit.text = text;
    }
    return { ...orbit.camera(read.defaultCamera, widthPx, heightPx), text: orbit.text };
  },
  /** The objects of a stream as they come, and the other files of a packed one but manifest and index. */
  async allObjects({ url }) {
    try {
      const stream = /** @type {any} */ (await openSource(url, new Fetcher({ giveUpS: 2 })));
      /** @type {Record<string, string>} */
      const found = {};
      for (const record of stream.records) {
        for (const [part, name] of stream.manifest.parts.entries()) {
          const { bytes } = await stream.objectBytes(record, part, () => {});
          found[`segments/${record.segment}/${name}`] = Buffer.from(bytes).toString("hex");
        }
      }
      const files = await Promise.all(
        Object.entries(stream.files).map(async ([path, place]) => {
          const { bytes } = await fetchRange(stream.fetcher, stream.base, place);
          return [path, Buffer.from(bytes).toString("hex")];
        }),
      );
      return { found, files: Object.fromEntries(files) };
    } catch (error) {
      if (error instanceof SourceError) return { failed: error.message };
      throw error;
    }
  },
  /** Layouts of storyboards. */
  storyboards({ streams }) {
    return streams.map((/** @type {[number, number]} */ [numFrames, fps]) =>
      storyboardLayout(numFrames, fps),
    );
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
