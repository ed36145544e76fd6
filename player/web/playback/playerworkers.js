import { firstUrls } from "../source/addresses.js";
import { offerEarly } from "../source/early/earlyrequests.js";
import { startWorker } from "./startworker.js";

/** @typedef {import("./sortworker.js").SortedFrame} SortedFrame */

/**
 * The stream to open.
 * @typedef {object} Source
 * @property {string} base URL of its folder, with a slash at its end
 * @property {number | null} maxGaussians
 * @property {boolean} otherHosts
 * @property {number} [bufferBytes] most that is kept of what was received
 * @property {boolean} isHeld whether no frame is fetched until it plays or seeks
 */

/** The two workers of a player: one for network and decoding, one that sorts. */
export class PlayerWorkers {
  /** @type {"none" | "waiting" | "due"} whether the sorter has a request, and answers at once */
  #request = "none";
  /** Number of the last request; an earlier one may be answered while it is on its way. */
  #lastRequest = 0;
  /** Whether Gaussians were on their way at the last request. */
  #isMoving = false;
  /** Ends early requests. */
  #opening = new AbortController();
  /** @type {number[]} (4, 4) world to camera of the last request */
  requestedW2c = [];

  /**
   * @param {Source} source
   * @param {import("./streamplayer.js").Start} start
   * @param {(data: any) => void} onMessage of the worker that decodes
   * @param {(sorted: SortedFrame) => void} onSorted
   */
  constructor(source, start, onMessage, onSorted) {
    const { port1, port2 } = new MessageChannel();
    this.sorter = startWorker(new URL("./sortworker.js", import.meta.url));
    this.sorter.onmessage = ({ data }) => {
      if (data.request === this.#lastRequest) this.#request = "none";
      onSorted(data);
    };
    this.sorter.postMessage({ port: port2 }, [port2]);
    this.player = startWorker(new URL("./playworker.js", import.meta.url));
    this.player.onmessage = ({ data }) => onMessage(data);
    for (const worker of [this.player, this.sorter]) {
      worker.onerror = ({ message }) => {
        // A worker that never began has no message.
        const why =
          message ?? "one of its scripts was not loaded; see the errors in the browser's console";
        onMessage({ kind: "failed", message: `The player failed: ${why}` });
      };
    }
    // One that is opened again at a frame has been played or sought.
    const isHeld = source.isHeld && start.frame === null;
    const early = offerEarly(firstUrls(source.base), this.#opening.signal);
    const ports = [port1, ...early.map(({ port }) => port)];
    this.player.postMessage({ kind: "open", ...source, isHeld, start, early, port: port1 }, ports);
  }

  /** @param {{ kind: string } & Record<string, unknown>} message to the worker that decodes */
  post(message) {
    this.player.postMessage(message);
  }

  /** Whether the last order was that of the last camera, and no frame has come since. */
  get isSettled() {
    return this.#request === "waiting";
  }

  /**
   * Has the sorter always keep a request: it answers when it has a new frame, or at once if the camera
   * has moved. At most one of the second kind is underway.
   * @param {number[]} w2c (4, 4) world to camera
   * @param {number} nearM
   * @param {boolean} isMoving whether Gaussians are on their way: it is the order half way then, with those
   *   that fade out
   */
  requestOrder(w2c, nearM, isMoving) {
    const isMoved =
      isMoving !== this.#isMoving || w2c.some((entry, i) => entry !== this.requestedW2c[i]);
    if (this.#request === "due" || (this.#request === "waiting" && !isMoved)) return;
    this.#lastRequest += 1;
    const view = { w2c, nearM, isMoving, request: this.#lastRequest };
    this.sorter.postMessage({ view, isMoved });
    this.#request = isMoved ? "due" : "waiting";
    this.requestedW2c = w2c;
    this.#isMoving = isMoving;
  }

  terminate() {
    this.#opening.abort();
    this.player.terminate();
    this.sorter.terminate();
  }
}
