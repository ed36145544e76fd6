/** An object of sound, and its Opus packets as a file that browsers can decode (RFC 3533, RFC 7845). */

import {
  MAX_PACKET_SAMPLES,
  MAX_PACKETS,
  MAX_POSITION,
  MAX_SOUND_BYTES,
  SAMPLE_RATE,
  SOUND_HEAD,
  SOUND_MAGIC,
} from "../constants.js";
import { ByteReader, corrupt, isMagic } from "../format/bytes.js";
import { crc32 } from "../format/objects.js";

const FIRST = 2;
const LAST = 4;
/** Limit for one page: it can list 255 lengths, of which the last one must be below 255. */
const MOST_PACKET_BYTES = 254 * 255;

const TABLE = new Uint32Array(256).map((_, n) => {
  let c = n << 24;
  for (let bit = 0; bit < 8; bit++) c = c < 0 ? (c << 1) ^ 0x04c11db7 : c << 1;
  return c;
});

/**
 * A file that decodes to all samples of the packets, with a pre-skip of 0. Throws a FormatError.
 * @param {Uint8Array[]} packets @param {number[]} ends position where each packet ends, from 0 on
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
  for (const [n, packet] of packets.entries())
    pages.push(page(packet, n + 2, ends[n], n === packets.length - 1 ? LAST : 0));
  const file = new Uint8Array(pages.reduce((sum, { length }) => sum + length, 0));
  let at = 0;
  for (const one of pages) {
    file.set(one, at);
    at += one.length;
  }
  return file;
}

/** @param {Uint8Array} bytes @param {string} letters */
function write(bytes, letters) {
  bytes.set([...letters].map((letter) => letter.charCodeAt(0)));
}

/**
 * A page with one packet.
 * @param {Uint8Array} packet @param {number} number of the page
 * @param {number} position where the packet ends @param {number} flags
 */
function page(packet, number, position, flags) {
  if (packet.length > MOST_PACKET_BYTES) throw corrupt(`sound: a packet of ${packet.length} bytes`);
  const whole = new Uint8Array(Math.floor(packet.length / 255)).fill(255);
  const lengths = [...whole, packet.length % 255];
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

const CHECKED_FROM = 12;

/** Maximum distance of packets from the samples of their segment. */
const MOST_ASIDE = SAMPLE_RATE;

/**
 * The packets of one source in one segment (FORMAT.md, section 14).
 * @typedef {object} SoundObject
 * @property {number} preSkip position of sample 0
 * @property {number} numSamples length of the whole source
 * @property {Uint8Array[]} packets
 * @property {number[]} positions where each packet begins, and where the last one ends
 * @property {number} numBytes size of the object
 */

/**
 * Reads the object in `bytes`. Throws a FormatError.
 * @param {Uint8Array} bytes @param {number} numChannels of the source @returns {SoundObject}
 */
export function readSoundObject(bytes, numChannels) {
  const reader = new ByteReader(bytes, "sound");
  const [magic, size, checksum, channels, reserved, preSkip, count, first, numSamples] =
    reader.unpack(SOUND_HEAD);
  if (!isMagic(magic, SOUND_MAGIC)) throw corrupt("sound: this is not an object of sound");
  if (size !== bytes.length || size > MAX_SOUND_BYTES)
    throw corrupt(`sound: ${bytes.length} bytes, but it says ${size}`);
  if (crc32(bytes.subarray(CHECKED_FROM)) !== checksum)
    throw corrupt("sound: the checksum is wrong");
  if (channels !== numChannels || reserved !== 0)
    throw corrupt(`sound: ${channels} channels, not ${numChannels}`);
  if (count > MAX_PACKETS || Math.max(first, numSamples) > MAX_POSITION)
    throw corrupt("sound: a position or the number of packets is out of range");
  reader.take(2 * count);
  reader.at -= 2 * count;
  const sizes = Array.from({ length: count }, () => reader.u16());
  const packets = sizes.map((packetBytes) => reader.take(packetBytes));
  reader.finish();
  const positions = [first];
  for (const [n, packet] of packets.entries()) positions.push(positions[n] + packetSamples(packet));
  return { preSkip, numSamples, packets, positions, numBytes: bytes.length };
}

/**
 * Throws a FormatError if the packets extend far beyond the samples of their segment.
 * @param {SoundObject} object @param {number} begin first sample @param {number} end the one after the last
 */
export function checkSpan({ preSkip, packets, positions }, begin, end) {
  const [first, last] = [positions[0] - preSkip, positions[packets.length] - preSkip];
  if (packets.length > 0 && (first < begin - MOST_ASIDE || last > end + MOST_ASIDE))
    throw corrupt(`sound: samples ${first} to ${last}, but its segment has ${begin} to ${end}`);
}

/**
 * Number of samples that an Opus packet decodes to (RFC 6716, section 3.1). Throws a FormatError.
 * @param {Uint8Array} packet
 */
function packetSamples(packet) {
  if (packet.length === 0) throw corrupt("sound: an empty packet");
  const config = packet[0] >> 3;
  const sizes =
    config < 12 ? [480, 960, 1920, 2880] : config < 16 ? [480, 960] : [120, 240, 480, 960];
  const frames = [1, 2, 2, packet.length > 1 ? packet[1] & 63 : 0][packet[0] & 3];
  const samples = frames * sizes[config % sizes.length];
  if (samples === 0 || samples > MAX_PACKET_SAMPLES)
    throw corrupt(`sound: a packet of ${samples} samples`);
  return samples;
}
