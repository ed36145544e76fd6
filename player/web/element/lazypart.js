/**
 * A part of the controls that is loaded when it is first used.
 * @template Part
 */
export class LazyPart {
  /** @type {Part | null} null until it was used */
  part = null;
  /** @type {Promise<Part> | null} */
  #loading = null;

  /**
   * @param {() => Promise<Part>} load
   * @param {() => void} failed it could not be loaded
   */
  constructor(load, failed) {
    this.load = load;
    this.failed = failed;
  }

  /** Has it do something, now or as soon as it is here. @param {(part: Part) => unknown} action */
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
