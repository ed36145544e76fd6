"""Reads packets and objects (section 6), written from codec/FORMAT.md alone."""

from __future__ import annotations

import struct
import zlib
from itertools import pairwise

import zstandard

from tests.goldens.decoder import Unsupported

LARGEST_CHUNK = 248512624
LARGEST_OBJECT = 2**30


def inflate(packet: bytes, largest: int) -> bytes:
    """The chunk in a packet, if it has at most `largest` bytes."""
    try:
        return inflated(packet, largest)
    except zstandard.ZstdError as error:
        raise AssertionError(error) from error


def inflated(packet: bytes, largest: int) -> bytes:
    if packet[:1] == b"\1":
        return coded_change(packet, largest)
    assert packet[:4] == b"\x28\xb5\x2f\xfd"
    said = zstandard.get_frame_parameters(packet)
    assert said.has_checksum
    assert said.dict_id == 0
    assert said.content_size <= min(32768 * len(packet), largest)
    return zstandard.ZstdDecompressor().decompress(packet, allow_extra_data=False)


class Bits:
    """A bit string; no bit is taken that is not there."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, count: int) -> int:
        value = 0
        for n in range(count):
            value |= (self.data[self.at // 8] >> (self.at % 8) & 1) << n
            self.at += 1
        return value

    def value(self, c: int) -> int:
        ones = least = 0
        while ones < 12 and self.take(1):
            least += 2 ** min(8, c // 4 + ones // 2 ** (c % 4))
            ones += 1
        return least + self.take(8 if ones == 12 else min(8, c // 4 + ones // 2 ** (c % 4)))

    def rest(self) -> bytes:
        while self.at % 8:
            assert self.take(1) == 0
        return self.data[self.at // 8 :]


def coded_change(packet: bytes, largest: int) -> bytes:
    """Section 10.5: the chunk in a packet of coded planes."""
    assert len(packet) >= 12
    assert packet[-4:] == struct.pack("<I", zlib.crc32(packet[:-4]))
    flags, layer, zero, birth = struct.unpack_from("<BBBi", packet, 1)
    if flags > 7 or zero:
        raise Unsupported
    bits, largest = Bits(packet[8:-4]), min(32768 * len(packet), largest)
    try:
        predicted, new, escapes = (bits.take(bits.take(5)) for _ in range(3))
        k = (flags % 4 + 1) ** 2
        assert 32 + (10 + 3 * k) * (predicted + new) <= largest
        residuals = predicted_planes(bits, predicted, k) if predicted else []
        planes = [new_plane(bits, new) for _ in range(10 + 3 * k)] if new else []
    except IndexError as error:
        raise AssertionError from error
    rest = bits.rest()
    longs = 4 * sum(plane.count(255) for plane in residuals[:3])
    low_bits = sum(max(0, length - 1) for plane in planes[:3] for length in plane)
    counts = struct.pack("<5I", predicted, new, longs // 4, escapes, (low_bits + 7) // 8)
    head = struct.pack("<4sBBBBi", b"SWG1", 1, layer, flags // 4, 0, birth) + counts
    assert longs <= len(rest)
    chunk = b"".join([head, *residuals, rest[:longs], *planes, rest[longs:]])
    assert len(chunk) <= largest
    return chunk


def predicted_planes(bits: Bits, count: int, k: int) -> list[bytes]:
    planes = [bytearray(count) for _ in range(10 + 3 * k)]
    colours = [(9 + n, 9 + k + n, 9 + 2 * k + n) for n in range(k)]
    for group in [(0, 1, 2, 9 + 3 * k), (3, 4, 5), (6, 7, 8), *colours]:
        lengths = [bits.take(3) for _ in range(2 ** len(group))]
        patterns = group_patterns(bits, count, lengths)
        for j, plane in enumerate(group):
            if not any(length for pattern, length in enumerate(lengths) if pattern >> j & 1):
                continue
            c = bits.take(5)
            for i in range(count):
                if patterns[i] >> j & 1:
                    planes[plane][i] = byte(bits.value(c) + 1)
    return list(map(bytes, planes))


def group_patterns(bits: Bits, count: int, lengths: list[int]) -> list[int]:
    used = [pattern for pattern, length in enumerate(lengths) if length]
    if len(used) == 1:
        return used * count
    assert sum(2.0**-length for length in lengths if length) == 1
    codes, code = {}, 0
    for length in range(1, 8):
        code *= 2
        for pattern in used:
            if lengths[pattern] == length:
                codes[length, code] = pattern
                code += 1
    patterns = []
    for _ in range(count):
        length = code = 0
        while (length, code) not in codes:
            length, code = length + 1, 2 * code + bits.take(1)
        patterns.append(codes[length, code])
    return patterns


def new_plane(bits: Bits, count: int) -> bytes:
    centre, c = bits.take(8), bits.take(5)
    values = [byte(bits.value(c)) for _ in range(count)]
    return bytes((centre + (-(z + 1) // 2 if z % 2 else z // 2)) % 256 for z in values)


def byte(value: int) -> int:
    assert value <= 255
    return value


def decode_object(data: bytes, largest: int = LARGEST_CHUNK) -> list[bytes]:
    """The chunks of an object, inflated, in order; each has at most `largest` bytes."""
    assert 20 <= len(data) <= LARGEST_OBJECT
    skippable, following, magic, version, coder, zero, count = struct.unpack_from("<II4sBBHI", data)
    assert (skippable, following) == (0x184D2A50, 12 + 12 * count)
    assert magic == b"SWGO"
    if version != 1 or coder != 2:
        raise Unsupported
    assert zero == 0
    assert count <= 16384
    assert len(data) >= 20 + 12 * count
    chunks, end, births = [], 20 + 12 * count, []
    for entry in range(count):
        birth, offset, size = struct.unpack_from("<iII", data, 20 + 12 * entry)
        assert offset == end
        end += size
        assert end <= len(data)
        packet = data[offset:end]
        chunks.append(inflate(packet, largest))
        assert chunks[-1][8:12] == struct.pack("<i", birth)
        births.append(birth)
    assert all(earlier < later for earlier, later in pairwise(births))
    assert end == len(data)
    return chunks
