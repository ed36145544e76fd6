import { SAMPLE_RATE } from "../constants.js";

/** What is decoded at once: a long segment is not held whole. */
const PIECE_SAMPLES = 2 * SAMPLE_RATE;

/**
 * A part of a segment, in samples of the stream.
 * @typedef {object} Piece
 * @property {number} segment
 * @property {number} begin
 * @property {number} end
 */

/** Which samples are heard with which frames: frame f begins at sample floor(f * 48000 / fps). */
export class Timeline {
  /**
   * @param {number} fps
   * @param {number} segmentFrames
   * @param {number} numFrames
   */
  constructor(fps, segmentFrames, numFrames) {
    this.fps = fps;
    this.segmentFrames = segmentFrames;
    this.numFrames = numFrames;
    /** Of the stream. */
    this.length = this.#sampleOf(numFrames);
  }

  /** @param {number} frame */
  #sampleOf(frame) {
    return Math.floor((Math.min(frame, this.numFrames) * SAMPLE_RATE) / this.fps);
  }

  /** The piece that holds a sample of the stream. @param {number} sample @returns {Piece} */
  pieceAt(sample) {
    const { fps, segmentFrames } = this;
    const edge = (/** @type {number} */ segment) => this.#sampleOf(segment * segmentFrames);
    let segment = Math.floor((sample * fps) / SAMPLE_RATE / segmentFrames);
    if (edge(segment + 1) <= sample) segment += 1; // the edges are rounded
    if (edge(segment) > sample) segment -= 1;
    const first = edge(segment);
    const begin = first + Math.floor((sample - first) / PIECE_SAMPLES) * PIECE_SAMPLES;
    return { segment, begin, end: Math.min(begin + PIECE_SAMPLES, edge(segment + 1)) };
  }

  /**
   * The pieces from a sample on, at most `most`; around the end of the stream if it loops.
   * @param {number} sample
   * @param {number} count samples
   * @param {boolean} loops
   * @param {number} most
   */
  piecesFrom(sample, count, loops, most) {
    const pieces = [];
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
