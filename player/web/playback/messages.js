/** The messages between a page and its workers. */

/**
 * What a worker posts and is posted; see `Worker` and `DedicatedWorkerGlobalScope`.
 * @template Posts
 * @template Hears
 * @typedef {object} Channel
 * @property {(message: Posts, transfer?: Transferable[]) => void} postMessage
 * @property {((event: MessageEvent<Hears>) => void) | null} onmessage
 */

/**
 * The page's wish to open a stream.
 * @typedef {object} Source
 * @property {string} base URL of its folder, with a trailing slash, or of its file
 * @property {number | null} [maxGaussians] @property {boolean} [otherHosts]
 * @property {RequestCredentials} [credentials] whether requests carry cookies, see `fetch`
 * @property {import("../source/transform.js").TransformRequest} [transformRequest] changes each request
 * @property {number} [bufferBytes] limit for the received data that is kept
 * @property {boolean} [isHeld] whether to fetch no frame until the stream plays or seeks
 */

/**
 * Initial state of a play; properties that are left out have their defaults.
 * @typedef {object} Start
 * @property {number | null} [frame] null: the first one, or the edge of a live stream
 * @property {number} [seeks] number of seeks that the page has made
 * @property {number} [rate] @property {boolean} [loop]
 * @property {number | null} [mostLayers] null: all of them
 */

/** @typedef {import("../source/early.js").EarlyOffer} EarlyOffer */

/**
 * The wish as the play worker gets it: it asks for the changes of a request through a port.
 * @typedef {Omit<Source, "transformRequest"> & { transformRequest?: MessagePort }} Opening
 */

/**
 * From the page to the play worker. `port` leads to the worker that takes the frames.
 * @typedef {Opening & { kind: "open", start?: Start, early?: EarlyOffer[], port?: MessagePort }
 *   | { kind: "play", playing: boolean }
 *   | { kind: "seek", frame: number, seeks: number }
 *   | { kind: "scrub", frame: number }
 *   | { kind: "rate", rate: number }
 *   | { kind: "loop", loop: boolean }
 *   | { kind: "layers", most: number }
 *   | { kind: "follow", line: number, byMs: number }
 *   | { kind: "ply" | "resend" }} ToPlayer
 */

/**
 * A manifest in a form that can be posted.
 * @typedef {Omit<import("../format/manifest.js").Manifest, "layout">
 *   & { lattices: import("../format/gaussians.js").Lattice[] }} OpenManifest
 */

/**
 * State of a play.
 * @typedef {object} PlayState
 * @property {number} frame the one that shows
 * @property {number} endFrame the first missing frame
 * @property {[number, number][]} bufferedRanges [first, end) of the frames that have arrived
 * @property {boolean} playing
 * @property {boolean} waiting whether playback waits for data
 * @property {number} stalls
 * @property {number} layers number of layers that show
 * @property {number | null} rateBps estimated throughput
 * @property {number} receivedBytes
 * @property {number} decodeMs of the last frame
 */

/**
 * The times when frames are due: frame 0 at `zeroMs` (Unix time), which is null while playback does not run.
 * @typedef {{ zeroMs: number | null, rate: number, line: number }} Line
 */

/** @typedef {import("../source/source.js").SourceStream["files"]} Files */

/**
 * From the play worker to the page; a `message` of null: the trouble is over, or there is no file.
 * @typedef {{ kind: "opened", manifest: OpenManifest, numFrames: number, base: string, files: Files }
 *   | { kind: "grown", numFrames: number, live: boolean }
 *   | PlayState & { kind: "state" }
 *   | Line & { kind: "line" }
 *   | { kind: "ended" }
 *   | { kind: "failed", message: string }
 *   | { kind: "trouble" | "awaited", message: string | null }
 *   | { kind: "ply", message: { frame: number, file: Blob } | null }} FromPlayer
 */

/**
 * From the play worker to the one that takes the frames.
 * @typedef {import("./playback.js").Shown & { numSlots: number, shDegree: number, seeks: number }} ShownFrame
 */

/** @typedef {{ port: MessagePort }} ToSink what the page first posts to the worker that takes the frames */

/**
 * From the page to the sorter. `isMoved`: it answers at once.
 * @typedef {ToSink | { view: View, isMoved: boolean }} ToSorter
 */

/** @typedef {{ w2c: number[], nearM: number, isMoving: boolean, request: number }} View */

/**
 * A picture's draw order, with the changes since the last one; from the sorter to the page.
 * @typedef {object} SortedFrame
 * @property {number} request number of the request that this answers
 * @property {number} frame
 * @property {number} seeks number of seeks that the player had made
 * @property {boolean} isWhole whether `updates` are complete, independent of the renderer's state
 * @property {import("./depthorder.js").Words[]} updates
 * @property {Uint16Array | Uint32Array} order slots, farthest first; numbers beyond the last slot are the
 *   Gaussians that the newest update lets fade out, in the update's order, if that was requested
 * @property {number} sortMs
 */

/** @typedef {ToSink | { manifest: OpenManifest } | { take: true }} ToKeeper from the page to the feed's worker */

/** @typedef {import("../feed/scene.js").SceneChange & { seeks: number }} FromKeeper */

export {};
