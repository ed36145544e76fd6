import { FormatError } from "../format/bytes/errors.js";
import { SlotDecoder } from "../format/slots/slotdecoder.js";
import { isPacked, servedBase } from "./addresses.js";
import { HostedStream } from "./hosted.js";
import { PackedStream } from "./packed.js";
import { ServedStream } from "./served.js";

/**
 * Parameters of one play.
 * @typedef {object} PlayRequest
 * @property {number} firstFrame
 * @property {number} mostLayers
 * @property {() => number} nowS the clock
 */

/**
 * One play, from a frame on: brings what is missing into the stream's cache.
 * @typedef {object} SourcePlay
 * @property {() => number} step does what is to be done; gives seconds until it should be called
 *   again, at most
 * @property {(frame: number, paused: boolean, rate: number) => void} reportPosition takes the
 *   frame that shows next, or while playback is paused the one that shows; a negative one if frame 0
 *   shows only after so many others
 * @property {(frame: number, isStep: boolean) => boolean} moveTo goes on from another frame, if a new
 *   play would ask for nothing else; gives whether. isStep: the frame follows on what shows.
 * @property {number | null} rateBps what the link is taken to carry
 * @property {unknown} failure what ended it; null while nothing did
 * @property {() => void} onData called when something has come or failed
 * @property {boolean} isDone whether nothing more will be asked for
 * @property {() => void} close aborts what was asked for
 */

/**
 * A stream, wherever it comes from.
 * @typedef {object} SourceStream
 * @property {string} base URL of its folder, with a slash at its end, or of its file
 * @property {Record<string, import("../format/packedlayout.js").Place> | null} files where its
 *   pictures, captions and sound lie in that file, by path; null: beside the manifest
 * @property {import("../format/manifest.js").Manifest} manifest whose `live` is as it is now
 * @property {number} numFrames that there are now
 * @property {import("./segmentcache.js").SegmentCache} cache what is here
 * @property {(request: PlayRequest) => SourcePlay} play
 * @property {(segment: number, layer: number, signal: AbortSignal) => Promise<unknown>} fetchSnapshot
 *   brings a snapshot into the cache
 * @property {(onGrown: () => void) => Promise<void>} follow calls `onGrown` when there are more
 *   frames, or never will be; rejects if the source fails
 */

/**
 * The stream at a URL: of a swings server where the URL is one of its own, else a folder of files or a
 * packed stream on any host. Rejects with a SourceError or a FormatError.
 * @param {string} url see `folderUrl`
 * @param {import("./fetcher.js").Fetcher} fetcher
 * @param {number | null} maxGaussians most of a stream that is opened; null for the default
 * @param {boolean} otherHosts whether a manifest may lead to other hosts than its own
 * @param {number} [bufferBytes] most that is kept of the stream
 * @returns {Promise<SourceStream>}
 */
export async function openSource(
  url,
  fetcher,
  maxGaussians = null,
  otherHosts = false,
  bufferBytes,
) {
  const served = servedBase(url);
  const Hosted = isPacked(url) ? PackedStream : HostedStream;
  const stream = await (served === null
    ? Hosted.open(url, fetcher, maxGaussians, otherHosts, bufferBytes)
    : ServedStream.open(served, fetcher, maxGaussians, bufferBytes));
  const { layout } = stream.manifest;
  if (layout.period > 1) {
    const { passingDecoder } = await import("../format/slots/passing.js");
    layout.Decoder = passingDecoder(SlotDecoder, FormatError);
  }
  return stream;
}
