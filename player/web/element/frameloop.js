/** Calls back once before the browser's next picture if requested; idle otherwise. */
export class FrameLoop {
  #id = 0;
  #requestedMs = 0;

  /** @param {(nowMs: number) => void} draw */
  constructor(draw) {
    this.draw = draw;
  }

  request() {
    if (this.#id !== 0) return;
    this.#requestedMs = performance.now();
    this.#id = requestAnimationFrame((nowMs) => {
      this.#id = 0;
      this.draw(nowMs);
    });
  }

  /** How long the browser has let a request wait, in milliseconds; 0 if there is none. */
  get waitedMs() {
    return this.#id === 0 ? 0 : performance.now() - this.#requestedMs;
  }

  /** Calls back now instead of before the next picture. */
  flush() {
    this.stop();
    this.draw(performance.now());
  }

  stop() {
    cancelAnimationFrame(this.#id);
    this.#id = 0;
  }
}
