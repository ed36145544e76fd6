/** The stream as delivery sees it: what each packet takes, and what it gives (server/abr/media.py). */

/** What doubling a stream is taken to gain where the index does not say, dB. */
const UNKNOWN_GAIN_DB = 3;
/** Bytes of a Gaussian that a slice predicts, as a share of what it takes in a snapshot. */
const SENT_SHARE_OF_WHOLE = 0.4;

/**
 * What the slices of a segment take and give, for each layer.
 * @typedef {object} SegmentSizes
 * @property {number[]} layerBytes mean of a slice's packet; the mask is counted with layer 0
 * @property {number[]} gainsDb what the layer adds to those before it; of layer 0 its PSNR
 * @property {number[]} sliceBytes mean of a slice with 1, 2, ... layers
 * @property {number[]} snapshotBytes (version 2; else none)
 * @property {number[]} changedShares of the layer's slots that a slice changes (version 2; else none)
 */

/**
 * @param {number[]} layerBytes
 * @param {number[]} psnrDb of the layers up to this one, rising
 * @param {number[]} snapshotBytes
 * @param {number[]} changedShares
 * @returns {SegmentSizes}
 */
export function makeSizes(layerBytes, psnrDb, snapshotBytes = [], changedShares = []) {
  const gainsDb = psnrDb.map((psnr, layer) => (layer ? psnr - psnrDb[layer - 1] : psnr));
  return {
    layerBytes,
    gainsDb,
    sliceBytes: accumulated(layerBytes),
    snapshotBytes,
    changedShares,
  };
}

/** @param {number[]} values */
function accumulated(values) {
  let sum = 0;
  return values.map((value) => (sum += value));
}

/**
 * PSNRs without what no player can use: never falling from one layer to the next, and guessed from
 * the sizes where one is unknown.
 * @param {number[]} psnrDb
 * @param {number[]} layerBytes
 */
function rising(psnrDb, layerBytes) {
  const totals = accumulated(layerBytes);
  let known = psnrDb;
  if (psnrDb.some(Number.isNaN)) {
    const whole = Math.max(totals[totals.length - 1], 1);
    known = totals.map((total) => 30 + UNKNOWN_GAIN_DB * Math.log2(Math.max(total, 1) / whole));
  }
  let best = -Infinity;
  return known.map((psnr) => (best = Math.max(best, psnr)));
}

/**
 * What the index says of a segment.
 * @param {import("../format/streamindex.js").SegmentRecord} record
 * @param {import("../format/manifest.js").Manifest} manifest
 */
export function segmentSizes(record, manifest) {
  const { numLayers } = manifest;
  const early = record.segment === 0 && manifest.layout === null ? manifest.swinSize - 1 : 0;
  const numBirths = record.numFrames + early;
  const layerBytes = record.objectBytes.slice(0, numLayers).map((size) => size / numBirths);
  if (manifest.layout === null) return makeSizes(layerBytes, rising(record.psnrDb, layerBytes));
  const [masksBytes, ...snapshotBytes] = record.objectBytes.slice(numLayers);
  const changedShares = layerBytes.map((sent, layer) =>
    Math.min(1, sent / Math.max(1, SENT_SHARE_OF_WHOLE * snapshotBytes[layer])),
  );
  layerBytes[0] += masksBytes / numBirths;
  return makeSizes(layerBytes, rising(record.psnrDb, layerBytes), snapshotBytes, changedShares);
}

/** The stream that is delivered; it may grow. */
export class Media {
  /**
   * @param {object} shape
   * @param {number} shape.fps
   * @param {number} shape.swinSize
   * @param {number} shape.segmentFrames
   * @param {boolean} shape.hasSlots
   * @param {number} shape.numLayers
   */
  constructor({ fps, swinSize, segmentFrames, hasSlots, numLayers }) {
    this.fps = fps;
    this.swinSize = swinSize;
    this.segmentFrames = segmentFrames;
    this.hasSlots = hasSlots;
    this.numLayers = numLayers;
    /** Frames that can be sent now. */
    this.numFrames = 0;
    /** Whether numFrames may still grow. */
    this.live = false;
    /** @type {SegmentSizes[]} */
    this.segments = [];
  }

  /** Of the segment of the slice born at `birth`, which may lie before 0. @param {number} birth */
  sizes(birth) {
    return this.segments[Math.floor(Math.max(birth, 0) / this.segmentFrames)];
  }

  /** The first frame of the segment of the slice born at `birth`. @param {number} birth */
  segmentStart(birth) {
    return Math.floor(birth / this.segmentFrames) * this.segmentFrames;
  }
}

/**
 * A stream whose index says all.
 * @param {import("../format/manifest.js").Manifest} manifest
 * @param {import("../format/streamindex.js").SegmentRecord[]} records
 */
export function streamMedia(manifest, records) {
  const media = new Media({ ...manifest, hasSlots: manifest.layout !== null });
  growMedia(media, manifest, records);
  return media;
}

/**
 * Takes in what the index says of the segments that follow, and whether more may come.
 * @param {Media} media
 * @param {import("../format/manifest.js").Manifest} manifest
 * @param {import("../format/streamindex.js").SegmentRecord[]} records
 */
export function growMedia(media, manifest, records) {
  for (const record of records) {
    media.segments.push(segmentSizes(record, manifest));
    media.numFrames = record.firstFrame + record.numFrames;
  }
  media.live = manifest.live;
}
