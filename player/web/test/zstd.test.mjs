/** The decoder of packets: what it takes, what it refuses, and how long it may take. */
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { limitBytes, readManifest } from "../format/manifest.js";
import { readObject } from "../format/objects.js";
import { packetContent } from "../format/planes.js";
import { xxhash } from "../format/xxhash.js";
import { filesOf, law } from "./support.mjs";

const HOSTILE = JSON.parse(
  readFileSync(new URL("../../../conformance/hostile.json", import.meta.url), "utf8"),
).filter(({ what }) => what === "packet");
const FILES = filesOf("late-and-escaped");
const MANIFEST = readManifest(FILES["manifest.json"]);
const PACKETS = Object.entries(FILES).flatMap(([path, bytes]) => {
  const part = /^segments\/\d+\/(.*)$/.exec(path)?.[1];
  const packets = part === undefined ? [] : [...readObject(bytes).values()];
  return packets.map((packet) => ({
    packet,
    limit: limitBytes(MANIFEST, MANIFEST.parts.indexOf(part)),
  }));
});

test("the checksum is XXH64 as its specification has it", () => {
  const hash = (text) => xxhash(new TextEncoder().encode(text)).toString(16);
  assert.deepEqual(
    ["", "a", "abc", "Call me Ishmael. Some years ago--never mind how long precisely-"].map(hash),
    ["51d8e999", "a98c6e5b", "ad770999", "70d6fd96"],
  );
});

for (const { name, hex, verdict, limit_bytes } of HOSTILE) {
  test(`a packet is ${verdict}: ${name}`, () => {
    const packet = Uint8Array.from(Buffer.from(hex, "hex"));
    if (verdict === "taken") assert.ok(packetContent(packet, limit_bytes).length > 0);
    else assert.throws(() => packetContent(packet, limit_bytes), { kind: verdict });
  });
}

/** One block of a frame that states `size`: no literals, and `count` sequences of the longest copies. */
function manyCopies(size, count) {
  const copies = [0, 255, (count - 0x7f00) & 255, (count - 0x7f00) >> 8, 0b010101 << 2];
  const block = [...copies, 0, 0, 52, 255, 255, 255, 255];
  const head = [0x28, 0xb5, 0x2f, 0xfd, 0x24, size, (block.length << 3) | 5, 0, 0];
  return Uint8Array.of(...head, ...block, 0, 0, 0, 0);
}

test("25 bytes that would copy 12 GB are refused at the first copy beyond their content", () => {
  const packet = manyCopies(100, 98047);
  assert.equal(packet.length, 25);
  assert.throws(() => packetContent(packet, 1000), { kind: "corrupt" });
});

law("a damaged packet is refused", 300, (random) => {
  const { packet, limit } = random.choice(PACKETS);
  const content = packetContent(packet, limit);
  const damaged = packet.slice();
  for (let n = random.integer(1, 4); n > 0; n--)
    damaged[random.integer(0, packet.length - 1)] = random.integer(0, 255);
  const cut = random.integer(0, 9) > 0 ? damaged : damaged.subarray(0, random.integer(1, 99));
  let found = null;
  try {
    found = packetContent(cut, limit);
  } catch (error) {
    assert.equal(error.name, "FormatError", error.stack);
  }
  // Bytes of no meaning, as that of the window, are all that may differ.
  if (found !== null) assert.deepEqual(found, content);
});
