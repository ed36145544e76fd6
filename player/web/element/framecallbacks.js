/**
 * The callbacks of `requestVideoFrameCallback`: each one is called once, after the next frame has been
 * drawn. https://wicg.github.io/video-rvfc/
 */
export class FrameCallbacks {
  /** @type {Map<number, VideoFrameRequestCallback>} */
  #callbacks = new Map();
  #lastHandle = 0;
  #presentedFrames = 0;

  /** @param {VideoFrameRequestCallback} callback @returns {number} a handle for `cancel` */
  request(callback) {
    if (typeof callback !== "function") throw new TypeError("the callback is not a function");
    this.#lastHandle += 1;
    this.#callbacks.set(this.#lastHandle, callback);
    return this.#lastHandle;
  }

  /** @param {number} handle */
  cancel(handle) {
    this.#callbacks.delete(handle);
  }

  /**
   * Runs the callbacks that were registered before this call, after a frame has been drawn.
   * @param {number} mediaTime seconds
   * @param {number} width pixels
   * @param {number} height pixels
   * @param {number} nowMs
   */
  run(mediaTime, width, height, nowMs) {
    this.#presentedFrames += 1;
    const presentedFrames = this.#presentedFrames;
    // Pages cannot know when the screen shows a canvas; the best guess is the next refresh.
    const times = { presentationTime: nowMs, expectedDisplayTime: nowMs, mediaTime };
    const due = [...this.#callbacks];
    for (const [handle, callback] of due) {
      if (!this.#callbacks.delete(handle)) continue;
      try {
        callback(nowMs, { ...times, presentedFrames, width, height });
      } catch (error) {
        reportError(error);
      }
    }
  }
}
