/** A static host and a clock that exist only in the test: nothing takes real time. */
import { loadPlanes } from "../playback/playsession.js";
import { settled } from "./support.mjs";

// In a page it comes while the first frames are buffered; here it would take real time.
await loadPlanes();

const STEP_MS = 10;

/** Replaces the clock, the timers and `fetch` until the test ends. */
export class VirtualHost {
  /**
   * @param {import("node:test").TestContext} context
   * @param {(path: string) => Response} answer
   * @param {(path: string) => number} delayS time until the answer
   */
  constructor(context, answer, delayS) {
    this.nowMs = 0;
    this.wasAsked = false;
    this.asked = [];
    this.aborted = [];
    this.waiting = new Set();
    context.mock.timers.enable({ apis: ["setTimeout"] });
    context.mock.method(performance, "now", () => this.nowMs);
    context.mock.method(globalThis, "fetch", (url, { signal } = {}) => {
      const path = new URL(url).pathname.slice(1);
      this.asked.push(path);
      this.wasAsked = true;
      return new Promise((resolve, reject) => {
        const one = {
          dueMs: this.nowMs + 1000 * delayS(path),
          come: () => resolve(answer(path)),
        };
        this.waiting.add(one);
        signal?.addEventListener("abort", () => {
          if (this.waiting.delete(one)) this.aborted.push(path);
          reject(signal.reason);
        });
      });
    });
    this.timers = context.mock.timers;
  }

  /** Waits in real time for the first request, before which a source's module is loaded. */
  async untilAsked(isOver = () => false) {
    while (!this.wasAsked && !isOver()) await settled();
  }

  /**
   * Lets time pass until `isOver`.
   * @param {() => boolean} isOver
   */
  async until(isOver, mostS = 60) {
    for (const endMs = this.nowMs + 1000 * mostS; !isOver(); ) {
      if (this.nowMs >= endMs) throw new Error(`nothing in ${mostS} s`);
      this.nowMs += STEP_MS;
      for (const one of this.waiting) {
        if (one.dueMs > this.nowMs) continue;
        this.waiting.delete(one);
        one.come();
      }
      await settled();
      this.timers.tick(STEP_MS);
      await settled();
    }
  }
}
