/** A packet is one chunk, compressed (FORMAT.md, section 6). Browsers can inflate gzip natively. */

import { CODERS, GZIP_MAGIC, MAX_CHUNK_BYTES, MAX_EXPANSION, ZSTD_MAGIC } from "../constants.js";
import { corrupt, FormatError, unsupported } from "./bytes/errors.js";
import { isSnapshot, layerOf, masksOf } from "./manifest.js";

const LEAST_BYTES = 18;

/**
 * Maximum size of the chunk in a packet.
 * @param {import("./manifest.js").Manifest} manifest
 * @param {import("./manifest.js").Part} part
 */
export function limitBytes({ layout }, part) {
  if (part === masksOf(layout)) return layout.maxMaskBytes;
  const layer = layerOf(layout, part);
  return isSnapshot(layout, part) ? layout.maxSnapshotBytes(layer) : layout.maxChangeBytes(layer);
}

/** @param {Uint8Array} packet */
export function isGzip(packet) {
  return isOfCoder(packet, CODERS.GZIP);
}

/** Whether a packet begins like those of `coder`. @param {Uint8Array} packet @param {number} coder */
export function isOfCoder(packet, coder) {
  const start = coder === CODERS.GZIP ? GZIP_MAGIC : ZSTD_MAGIC;
  return start.every((byte, i) => packet[i] === byte);
}

/**
 * Inflates the chunk in a gzip packet; an empty packet gives an empty chunk. Memory stays within the limit.
 * @param {Uint8Array} packet
 * @param {number} limitBytes
 * @returns {Promise<Uint8Array>} rejects with a FormatError
 */
export async function inflatePacket(packet, limitBytes) {
  if (packet.length === 0) return packet;
  const size = contentBytes(packet, Math.min(limitBytes, MAX_CHUNK_BYTES));
  const content = new Uint8Array(size);
  let at = 0;
  const copied = /** @type {Uint8Array<ArrayBuffer>} */ (packet.slice());
  const reader = new Blob([copied])
    .stream()
    .pipeThrough(new DecompressionStream("gzip"))
    .getReader();
  try {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      if (at + value.length > size)
        throw corrupt(`packet: the content is longer than the stated ${size} bytes`);
      content.set(value, at);
      at += value.length;
    }
  } catch (error) {
    await reader.cancel().catch(() => {}); // its error is known
    if (error instanceof FormatError) throw error;
    throw corrupt(`packet: is not gzip: ${/** @type {Error} */ (error).message}`);
  }
  if (at !== size)
    throw corrupt(`packet: the content has ${at} bytes, but the packet says ${size}`);
  return content;
}

/**
 * The inflated size that a gzip packet states.
 * @param {Uint8Array} packet
 * @param {number} limitBytes
 */
function contentBytes(packet, limitBytes) {
  if (packet.length < LEAST_BYTES) throw corrupt(`packet: ${packet.length} bytes are too few`);
  const view = new DataView(packet.buffer, packet.byteOffset, packet.length);
  if (isOfCoder(packet, CODERS.ZSTD))
    throw unsupported("packet: coder zstd; only gzip packets are supported here");
  if (!isGzip(packet)) throw corrupt("packet: is not a gzip member without flags");
  const size = view.getUint32(packet.length - 4, true);
  if (size === 0) throw corrupt("packet: is empty");
  if (size > MAX_EXPANSION * packet.length || size > limitBytes) {
    throw corrupt(
      `packet: ${size} bytes of content are too many for ${packet.length} bytes (limit ${limitBytes})`,
    );
  }
  return size;
}
