/** Packs Opus packets into a file that browsers can decode (RFC 3533, RFC 7845). */

import { SAMPLE_RATE } from "../constants.js";
import { corrupt } from "../format/bytes/errors.js";

const FIRST = 2;
const LAST = 4;
/** Limit for one page: it can list 255 lengths, of which the last one must be below 255. */
const MOST_PACKET_BYTES = 254 * 255;

const TABLE = Uint32Array.from({ length: 256 }, (_, n) => {
  let c = n << 24;
  for (let bit = 0; bit < 8; bit++) c = c < 0 ? (c << 1) ^ 0x04c11db7 : c << 1;
  return c;
});

/**
 * A file that decodes to all samples of the packets, with a pre-skip of 0. Throws a FormatError.
 * @param {Uint8Array[]} packets
 * @param {number[]} ends position where each packet ends, from 0 on
 * @param {number} channels
 */
export function oggOf(packets, ends, channels) {
  const head = new Uint8Array(19);
  const view = new DataView(head.buffer);
  write(head, "OpusHead");
  head.set([1, channels], 8);
  view.setUint32(12, SAMPLE_RATE, true);
  const tags = new Uint8Array(16);
  write(tags, "OpusTags");
  const pages = [page(head, 0, 0, FIRST), page(tags, 1, 0, 0)];
  for (const [n, packet] of packets.entries()) {
    pages.push(page(packet, n + 2, ends[n], n === packets.length - 1 ? LAST : 0));
  }
  const file = new Uint8Array(pages.reduce((sum, { length }) => sum + length, 0));
  let at = 0;
  for (const one of pages) {
    file.set(one, at);
    at += one.length;
  }
  return file;
}

/**
 * @param {Uint8Array} bytes
 * @param {string} letters
 */
function write(bytes, letters) {
  bytes.set([...letters].map((letter) => letter.charCodeAt(0)));
}

/**
 * A page with one packet.
 * @param {Uint8Array} packet
 * @param {number} number of the page
 * @param {number} position where the packet ends
 * @param {number} flags
 */
function page(packet, number, position, flags) {
  if (packet.length > MOST_PACKET_BYTES) throw corrupt(`sound: a packet of ${packet.length} bytes`);
  const lengths = new Array(Math.floor(packet.length / 255)).fill(255);
  lengths.push(packet.length % 255);
  const begin = 27 + lengths.length;
  const bytes = new Uint8Array(begin + packet.length);
  const view = new DataView(bytes.buffer);
  write(bytes, "OggS");
  bytes[5] = flags;
  view.setUint32(6, position, true);
  view.setUint32(18, number, true);
  bytes[26] = lengths.length;
  bytes.set(lengths, 27);
  bytes.set(packet, begin);
  let checksum = 0;
  for (const byte of bytes) checksum = (checksum << 8) ^ TABLE[(checksum >>> 24) ^ byte];
  view.setUint32(22, checksum >>> 0, true);
  return bytes;
}
