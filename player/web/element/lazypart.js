/**
 * A part of the player that is loaded by `import()`.
 * @template Part
 */
export class LazyPart {
  /** @type {Part | null} null until it is loaded */
  part = null;
  /** @type {Promise<Part | null> | null} */
  #loading = null;

  /**
   * @param {() => Promise<Part | null>} load gives null if the part is not needed any more
   * @param {(error: unknown) => void} failed called if the part could not be loaded; its next use tries again
   */
  constructor(load, failed) {
    this.load = load;
    this.failed = failed;
  }

  /**
   * Runs `action` with the part as soon as it is loaded: at once if it already is, because some actions must
   * run within a user gesture.
   * @param {(part: Part) => unknown} [action]
   */
  async use(action) {
    if (this.part === null) {
      try {
        this.#loading ??= this.load();
        this.part = await this.#loading;
      } catch (error) {
        this.#loading = null;
        this.failed(error);
      }
    }
    if (this.part !== null) await action?.(this.part);
  }
}
