import { HostedStream } from "./hosted.js";
import { servedBase, ServedStream } from "./served.js";

/**
 * What a source hands over: chunks of slices and snapshots, as a SlotPlay or a SlicePlay takes them.
 * @typedef {object} Sink
 * @property {(birth: number, chunk: Uint8Array) => void} addMask
 * @property {(birth: number, layer: number, chunk: Uint8Array) => void} addChange
 * @property {(frame: number, layer: number, chunk: Uint8Array) => void} addSnapshot
 */

/**
 * What is asked of one play.
 * @typedef {object} Wish
 * @property {number} firstFrame
 * @property {boolean} continues whether the sink has what shows before firstFrame
 * @property {number} mostLayers
 * @property {() => number} nowS the clock
 */

/**
 * One play, from a frame on: what comes goes to a sink.
 * @typedef {object} SourcePlay
 * @property {() => number} step does what is to be done; gives seconds until it should be called
 *   again, at most
 * @property {(frame: number, paused: boolean) => void} told the playback says where it is:
 *   the frame that shows next, or while it is paused the one that shows
 * @property {number | null} rateBps what the link is taken to carry
 * @property {unknown} failure what ended it; null while nothing did
 * @property {() => void} onNews called when something has come or failed
 * @property {() => void} close
 */

/**
 * A stream, wherever it comes from.
 * @typedef {object} SourceStream
 * @property {string} base URL of its folder, with a slash at its end
 * @property {import("../format/manifest.js").Manifest} manifest whose `live` is as it is now
 * @property {number} numFrames that there are now
 * @property {(sink: Sink, wish: Wish) => SourcePlay} play
 * @property {(onGrown: () => void) => Promise<void>} follow calls `onGrown` when there are more
 *   frames, or never will be; rejects if the source fails
 */

/**
 * The stream at a URL: of a swings server where the URL is one of its own, else a folder of files on
 * any host. Rejects with a SourceError or a FormatError.
 * @param {string} url with a slash at its end
 * @param {import("./fetcher.js").Fetcher} fetcher
 * @param {number | null} maxGaussians most of a stream that is opened; null for the default
 * @returns {Promise<SourceStream>}
 */
export function openSource(url, fetcher, maxGaussians = null) {
  const served = servedBase(url);
  return served === null
    ? HostedStream.open(url, fetcher, maxGaussians)
    : ServedStream.open(served, fetcher, maxGaussians);
}
