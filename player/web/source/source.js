import { isPacked, servedBase } from "./addresses.js";

/**
 * Parameters of one play.
 * @typedef {object} PlayRequest
 * @property {number} firstFrame @property {number} mostLayers
 * @property {() => number} nowS clock, seconds
 */

/** @typedef {"step" | "seek" | "loop"} Move "step": the frame continues the current picture */

/**
 * One play, from a frame on: fetches missing data into the stream's cache.
 * @typedef {object} SourcePlay
 * @property {() => number} step sends requests that are due; returns the maximum seconds until the next
 *   call
 * @property {(frame: number, paused: boolean, rate: number) => void} reportPosition reports the frame
 *   that shows next, or during a pause the current one; -n if n other frames show before frame 0
 * @property {(frame: number, how: Move) => boolean} moveTo continues from another frame, unless
 *   that needs a new play; returns whether it does
 * @property {(segment: number, layer: number, why: unknown) => void} [lose] notes that a layer of a segment
 *   is damaged
 * @property {number | null} rateBps estimated throughput of the link
 * @property {number} [waitS] least seconds from a request to its first byte
 * @property {unknown} failure the error that ended the play; null if there is none
 * @property {boolean} isFetching whether anything is under way, also after a failure
 * @property {() => void} onData called when data has arrived or a request has failed
 * @property {boolean} isDone whether nothing more will be requested
 * @property {() => void} close aborts all requests
 */

/**
 * A stream from any kind of source.
 * @typedef {object} SourceStream
 * @property {string} base URL of its folder, with a trailing slash, or of its file
 * @property {Record<string, import("./packed.js").Place> | null} files places of pictures,
 *   captions and sound in the file, by path; null: they are beside the manifest
 * @property {import("../format/manifest.js").Manifest} manifest its `live` is kept up to date
 * @property {number} numFrames current number of frames
 * @property {import("./segmentcache.js").SegmentCache} cache the received packets
 * @property {(request: PlayRequest) => SourcePlay} play
 * @property {(segment: number, layer: number, signal: AbortSignal) => Promise<unknown>} fetchKeyframe
 *   fetches a keyframe into the cache
 * @property {(error: unknown) => Promise<unknown>} explain the error to report for an error of a play
 * @property {(onGrown: () => void) => Promise<void>} follow calls `onGrown` when there are more frames,
 *   or when the stream has ended; rejects if the source fails
 */

/**
 * Opens the stream at a URL: on a swings server if the URL is one of its addresses, otherwise a folder of
 * files or a packed stream on any host. Rejects with a SourceError or a FormatError.
 * @param {string} url see `folderUrl` @param {import("./fetcher.js").Fetcher} fetcher
 * @param {number | null} maxGaussians limit for the stream's Gaussians; null for the default
 * @param {boolean} otherHosts whether a manifest may refer to hosts other than its own
 * @param {number} [bufferBytes] limit for the received data that is kept @returns {Promise<SourceStream>}
 */
export async function openSource(
  url,
  fetcher,
  maxGaussians = null,
  otherHosts = false,
  bufferBytes,
) {
  const served = servedBase(url);
  if (served !== null) {
    const { ServedStream } = await import("./served.js");
    return ServedStream.open(served, fetcher, maxGaussians, bufferBytes);
  }
  const hosting = import("./hosted.js"); // a packed stream needs it too
  const Stream = isPacked(url)
    ? (await import("./packed.js")).PackedStream
    : (await hosting).HostedStream;
  return Stream.open(url, fetcher, maxGaussians, otherHosts, bufferBytes);
}
