/** The canvas's picture as a video stream, for recorders and peers, and for picture in picture. */
export class Capture {
  #canvas;
  /** @type {Set<MediaStream>} streams whose tracks have not been stopped */
  #streams = new Set();

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.#canvas = canvas;
  }

  /** Whether a stream is still in use, that is, has a track that was not stopped. */
  get isLive() {
    for (const stream of this.#streams) {
      if (!stream.active) this.#streams.delete(stream);
    }
    return this.#streams.size > 0;
  }

  /**
   * @param {number} [fps] maximum number of pictures per second; by default every drawn picture
   * @returns {MediaStream} with one video track
   */
  stream(fps) {
    const stream = this.#canvas.captureStream(fps);
    this.#streams.add(stream);
    return stream;
  }

  /** Stops a stream. @param {MediaStream} stream */
  stop(stream) {
    for (const track of stream.getTracks()) track.stop();
    this.#streams.delete(stream);
  }

  /** Stops all streams. */
  close() {
    for (const stream of this.#streams) this.stop(stream);
  }
}
