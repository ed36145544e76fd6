/**
 * The message interface of a worker; the type of `self` is that of a page where the DOM types are loaded.
 * @typedef {object} WorkerScope
 * @property {(message: unknown, transfer?: Transferable[]) => void} postMessage
 * @property {((event: MessageEvent) => void) | null} onmessage
 */

export const scope = /** @type {WorkerScope} */ (/** @type {unknown} */ (self));
