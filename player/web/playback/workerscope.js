/**
 * Messages of a worker; `self` has another type where the page's own is known.
 * @typedef {object} WorkerScope
 * @property {(message: unknown, transfer?: Transferable[]) => void} postMessage
 * @property {((event: MessageEvent) => void) | null} onmessage
 */

export const scope = /** @type {WorkerScope} */ (/** @type {unknown} */ (self));
