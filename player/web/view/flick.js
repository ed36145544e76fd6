/** How long before it is let go a pointer's motion counts. */
const WINDOW_MS = 80;
const MOST_SAMPLES = 32;

/** How fast a pointer moves when it is let go. */
export class Flick {
  /** @type {{ atMs: number, by: number[] }[]} */
  #samples = [];

  /** @param {number} atMs @param {number[]} by since the sample before */
  add(atMs, by) {
    this.#samples.push({ atMs, by });
    if (this.#samples.length > MOST_SAMPLES) this.#samples.shift();
  }

  /** Units each second; 0 if the pointer has rested. @param {number} atMs @returns {number[]} */
  speed(atMs) {
    const recent = this.#samples.filter((sample) => atMs - sample.atMs <= WINDOW_MS);
    // The first sample's own way began before it: it only says since when.
    const [first, ...rest] = recent;
    if (rest.length === 0) return [];
    const spanS = Math.max(atMs - first.atMs, 8) / 1000;
    return first.by.map((_, i) => rest.reduce((sum, { by }) => sum + by[i], 0) / spanS);
  }
}
