/**
 * A part of the controls that is loaded when it is first used.
 * @template Part
 */
export class LazyPart {
  /** @type {Part | null} null until it is loaded */
  part = null;
  /** @type {Promise<Part> | null} */
  #loading = null;

  /**
   * @param {() => Promise<Part>} load
   * @param {() => void} failed called if the part could not be loaded
   */
  constructor(load, failed) {
    this.load = load;
    this.failed = failed;
  }

  /** Runs `action` with the part as soon as it is loaded. @param {(part: Part) => unknown} action */
  async use(action) {
    try {
      this.#loading ??= this.load();
      this.part = await this.#loading;
    } catch {
      this.#loading = null;
      this.failed();
      return;
    }
    await action(this.part);
  }
}
