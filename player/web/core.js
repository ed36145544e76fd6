/**
 * The player's format, fetching and playback state without a page, for workers, servers and tools.
 * A source's play fills the stream's cache; a Round inflates the packets that show soon, and its
 * `playback` gives the frame that is due.
 */

export { FormatError } from "./format/bytes/errors.js";
export { objectPath, readManifest } from "./format/manifest.js";
export { readObject } from "./format/objecttable.js";
export { packetContent } from "./format/packet.js";
export { SlotDecoder } from "./format/slots/slotdecoder.js";
export { readIndex } from "./format/streamindex.js";
export { Scene } from "./feed/scene.js";
export { Playback } from "./playback/playback.js";
export { Round } from "./playback/round.js";
export { StreamPlay } from "./playback/streamplay.js";
export { Fetcher, SourceError } from "./source/fetcher.js";
export { openSource } from "./source/source.js";
