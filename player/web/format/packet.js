/** A packet is one chunk, in a zstd frame (FORMAT.md, section 6). */

import { MAX_CHUNK_BYTES, MAX_EXPANSION } from "../constants.js";
import { corrupt } from "./bytes.js";
import { isKeyframe, layerOf, skipMapsOf } from "./manifest.js";
import { decodeFrame, readFrameHead } from "./zstd.js";

/**
 * Maximum size of the chunk in a packet.
 * @param {import("./manifest.js").Manifest} manifest @param {import("./manifest.js").Part} part
 */
export function limitBytes({ layout }, part) {
  if (part === skipMapsOf(layout)) return layout.maxSkipMapBytes;
  const layer = layerOf(layout, part);
  return isKeyframe(layout, part) ? layout.maxKeyframeBytes(layer) : layout.maxChangeBytes(layer);
}

/**
 * The chunk in a packet; an empty packet gives an empty chunk. Memory stays within the limit. Throws a FormatError.
 * @param {Uint8Array} packet @param {number} limitBytes
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
