/** A packet is one chunk, in a zstd frame (FORMAT.md, section 6). */

import { MAX_CHUNK_BYTES, MAX_EXPANSION } from "../constants.js";
import { corrupt } from "./bytes/errors.js";
import { decodeFrame, readFrameHead } from "./bytes/zstd.js";

/** The layer of a part; 0 for the masks. @param {string} part */
export const layerOf = (part) => Number(part.replace(/\D+/, ""));

/**
 * Maximum size of the chunk in a packet.
 * @param {import("./manifest.js").Manifest} manifest
 * @param {string} part
 */
export function limitBytes({ layout }, part) {
  if (part === "masks") return layout.maxMaskBytes;
  if (part.startsWith("snapshot-")) return layout.maxSnapshotBytes(layerOf(part));
  return layout.maxChangeBytes(layerOf(part));
}

/**
 * The chunk in a packet; an empty packet gives an empty chunk. Memory stays within the limit. Throws a FormatError.
 * @param {Uint8Array} packet
 * @param {number} limitBytes
 */
export function packetContent(packet, limitBytes) {
  if (packet.length === 0) return packet;
  const head = readFrameHead(packet);
  if (head.size === 0) throw corrupt("packet: its content is empty");
  const most = Math.min(limitBytes, MAX_CHUNK_BYTES, MAX_EXPANSION * packet.length);
  if (head.size > most)
    throw corrupt(`packet: ${head.size} bytes of content, but at most ${most} are allowed`);
  return decodeFrame(packet, head);
}
