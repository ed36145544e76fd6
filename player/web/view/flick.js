/** Time before a pointer's release in which its motion counts. */
const WINDOW_MS = 80;
const MOST_SAMPLES = 32;

/** Measures the speed of a pointer when it is released. */
export class Flick {
  /** @type {{ atMs: number, by: number[] }[]} */
  #samples = [];

  /** @param {number} atMs @param {number[]} by since the sample before */
  add(atMs, by) {
    this.#samples.push({ atMs, by });
    if (this.#samples.length > MOST_SAMPLES) this.#samples.shift();
  }

  /** Units per second; empty if the pointer has rested. @param {number} atMs @returns {number[]} */
  speed(atMs) {
    const recent = this.#samples.filter((sample) => atMs - sample.atMs <= WINDOW_MS);
    // The first sample's motion began before its time, so the sample only marks the start of the span.
    const [first, ...rest] = recent;
    if (rest.length === 0) return [];
    const spanS = Math.max(atMs - first.atMs, 8) / 1000;
    return first.by.map((_, i) => rest.reduce((sum, { by }) => sum + by[i], 0) / spanS);
  }
}
