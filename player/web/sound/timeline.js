import { SAMPLE_RATE } from "../constants.js";

/** Maximum length decoded at once, so that long segments need not be in memory as a whole. */
const PIECE_SAMPLES = 2 * SAMPLE_RATE;

/**
 * A part of a segment, in samples of the stream.
 * @typedef {object} Piece
 * @property {number} segment @property {number} begin @property {number} end
 */

/** Maps frames to samples: frame f begins at sample floor(f * 48000 / fps). */
export class Timeline {
  numFrames = 0;
  live = false;
  /** Length of the stream in samples. */
  length = 0;

  /** @param {number} fps @param {number} segmentFrames */
  constructor(fps, segmentFrames) {
    /** @type {number} */ this.fps = fps;
    /** @type {number} */ this.segmentFrames = segmentFrames;
  }

  /**
   * Sets the length of the stream. In a live stream only whole segments count, so that pieces never change.
   * @param {number} numFrames @param {boolean} live
   */
  reach(numFrames, live) {
    this.live = live;
    this.numFrames = live ? numFrames - (numFrames % this.segmentFrames) : numFrames;
    this.length = this.#sampleOf(this.numFrames);
  }

  /** @param {number} frame */
  #sampleOf(frame) {
    return Math.floor((frame * SAMPLE_RATE) / this.fps);
  }

  /** The first sample of a segment, and the one after its last. @param {number} segment */
  span(segment) {
    const edges = [segment, segment + 1].map((n) =>
      this.#sampleOf(Math.min(n * this.segmentFrames, this.numFrames)),
    );
    return /** @type {[number, number]} */ (edges);
  }

  /** The first sample of a round of a loop, counted from the first round on. @param {number} round */
  beginOf(round) {
    return this.#sampleOf(round * this.numFrames);
  }

  /** The round of a sample, counted from the first round on. @param {number} sample */
  roundOf(sample) {
    if (this.live) return 0;
    const round = Math.floor((sample * this.fps) / SAMPLE_RATE / this.numFrames);
    if (this.beginOf(round + 1) <= sample) return round + 1; // the edges are rounded
    return this.beginOf(round) > sample ? round - 1 : round;
  }

  /** The piece that contains a sample of the stream. @param {number} sample @returns {Piece} */
  pieceAt(sample) {
    const { fps, segmentFrames } = this;
    let segment = Math.floor((sample * fps) / SAMPLE_RATE / segmentFrames);
    if (this.span(segment)[1] <= sample) segment += 1; // the edges are rounded
    if (this.span(segment)[0] > sample) segment -= 1;
    const [first, last] = this.span(segment);
    const begin = first + Math.floor((sample - first) / PIECE_SAMPLES) * PIECE_SAMPLES;
    return { segment, begin, end: Math.min(begin + PIECE_SAMPLES, last) };
  }

  /**
   * The pieces from a sample on, at most `most`; continues at the stream's start if it loops.
   * @param {number} sample @param {number} count samples @param {boolean} loops @param {number} most
   */
  piecesFrom(sample, count, loops, most) {
    const pieces = /** @type {ReturnType<Timeline["pieceAt"]>[]} */ ([]);
    for (let left = count, at = sample; left > 0 && pieces.length < most; ) {
      if (at >= this.length) {
        if (!loops || this.length === 0) break;
        at = 0;
      }
      const piece = this.pieceAt(at);
      pieces.push(piece);
      left -= piece.end - at;
      at = piece.end;
    }
    return pieces;
  }
}
