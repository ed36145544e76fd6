/**
 * The player's format, fetching and playback state without a page, for workers, servers and tools.
 * A source's play fills the stream's cache; a PlaySession inflates the packets that show soon, and its
 * `playback` gives the frame that is due.
 */

export { FormatError } from "./format/bytes.js";
export { readManifest } from "./format/manifest.js";
export { readIndex, readObject } from "./format/objects.js";
export { packetContent } from "./format/planes.js";
export { SlotDecoder } from "./format/slots/slotdecoder.js";
export { Scene } from "./feed/scene.js";
export { Playback } from "./playback/playback.js";
export { PlaySession } from "./playback/playsession.js";
export { FrameAssembler } from "./playback/frameassembler.js";
export { Fetcher, SourceError } from "./source/fetcher.js";
export { objectPath } from "./source/files.js";
export { openSource } from "./source/source.js";
