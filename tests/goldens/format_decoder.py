"""A second decoder of objects and chunks, written from codec/FORMAT.md alone: slow and plain.

It shares no code with the package; `f32` is what a browser calls Math.fround.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from itertools import chain, pairwise

import zstandard

LARGEST_CHUNK = 248512584


def f32(value: float) -> float:
    """`value` rounded to the nearest float32, which is infinite for what is too large."""
    try:
        rounded: float = struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)
    return rounded


@dataclass(frozen=True, slots=True)
class PlainChunk:
    birth: int
    layer: int
    profile: int
    means: list[tuple[float, ...]]
    log_scales: list[tuple[float, ...]]
    quats: list[tuple[float, ...]]
    logit_opacities: list[float]
    sh: list[list[tuple[float, ...]]]
    start_offsets: list[int]


def rows(values: list[float], width: int) -> list[tuple[float, ...]]:
    return [tuple(values[i : i + width]) for i in range(0, len(values), width)]


def inflate(packet: bytes, largest: int = LARGEST_CHUNK) -> bytes:
    """The chunk in a packet of section 7, of either coder, if it has at most `largest` bytes."""
    try:
        return inflated(packet, largest)
    except (zstandard.ZstdError, zlib.error) as error:
        raise AssertionError(error) from error


def inflated(packet: bytes, largest: int) -> bytes:
    if packet[:4] == b"\x28\xb5\x2f\xfd":
        said = zstandard.get_frame_parameters(packet)
        assert said.has_checksum
        assert said.dict_id == 0
        assert said.content_size <= min(32768 * len(packet), largest)
        return zstandard.ZstdDecompressor().decompress(packet, allow_extra_data=False)
    assert packet[:4] == b"\x1f\x8b\x08\x00"
    assert len(packet) >= 18
    checksum, size = struct.unpack("<II", packet[-8:])
    assert size <= min(1032 * len(packet), largest)
    deflated = zlib.decompressobj(-15)
    content = deflated.decompress(packet[10:-8], size + 1)
    assert deflated.eof
    assert not deflated.unused_data
    assert (zlib.crc32(content), len(content)) == (checksum, size)
    return content


def decode_object(data: bytes, wanted: int = 1, largest: int = LARGEST_CHUNK) -> list[bytes]:
    """The chunks of an object of version `wanted`, inflated, in order."""
    assert 20 <= len(data) <= 2**30
    skippable, following, magic, version, coder, zero, count = struct.unpack_from("<II4sBBHI", data)
    assert (skippable, following) == (0x184D2A50, 12 + 12 * count)
    assert (magic, version, zero) == (b"SWGO", wanted, 0)
    assert coder in (1, 2)
    assert (1 if wanted == 1 else 0) <= count <= 16384
    assert len(data) >= 20 + 12 * count
    chunks, end, births = [], 20 + 12 * count, []
    for entry in range(count):
        birth, offset, size = struct.unpack_from("<iII", data, 20 + 12 * entry)
        assert offset == end
        end += size
        assert end <= len(data)
        packet = data[offset:end]
        assert (packet[:4] == b"\x1f\x8b\x08\x00") == (coder == 2)
        chunks.append(inflate(packet, largest))
        assert chunks[-1][8:12] == struct.pack("<i", birth)
        births.append(birth)
    assert all(earlier < later for earlier, later in pairwise(births))
    assert end == len(data)
    return chunks


def decode(chunk: bytes) -> PlainChunk:
    magic, version, mode, profile, flags, birth, count, layer, degree, zero, body_bytes = (
        struct.unpack_from("<4sBBBBiIBBHI", chunk)
    )
    assert (magic, version, mode, zero, flags & ~1) == (b"SWGC", 1, 0, 0, 0)
    assert len(chunk) == 24 + body_bytes
    body = chunk[24:]
    offsets = [0] * count
    if flags & 1:
        offsets = list(body[len(body) - count :])
        body = body[: len(body) - count]
    k = (degree + 1) ** 2
    parts = (raw, paper, compact)[profile](body, count, k)
    means, scales, quats, logits, sh = parts
    vectors = chain(means, scales, quats, [logits], *sh)
    assert all(map(math.isfinite, chain.from_iterable(vectors)))
    assert all(map(any, quats))
    return PlainChunk(birth, layer, profile, *parts, offsets)


Parts = tuple[
    list[tuple[float, ...]],
    list[tuple[float, ...]],
    list[tuple[float, ...]],
    list[float],
    list[list[tuple[float, ...]]],
]


def raw(body: bytes, count: int, k: int) -> Parts:
    assert len(body) == 4 * count * (11 + 3 * k)
    values = list(struct.unpack(f"<{len(body) // 4}f", body))
    ends = [0, 3 * count, 6 * count, 10 * count, 11 * count, len(values)]
    means, scales, quats, logits, sh = (values[a:b] for a, b in pairwise(ends))
    coefficients = rows(sh, 3)
    by_gaussian = [coefficients[i : i + k] for i in range(0, len(coefficients), k)]
    return rows(means, 3), rows(scales, 3), rows(quats, 4), logits, by_gaussian


def logit(level: int, levels: int) -> float:
    if level in (0, levels - 1):
        return 16.0 if level else -16.0
    return f32(math.log(level / (levels - 1 - level)))


def paper(body: bytes, count: int, k: int) -> Parts:
    assert len(body) == count * (17 + 12 * k)
    halves = list(struct.unpack_from(f"<{6 * count}e", body))
    turns = [(r - 128) / 128 for r in body[12 * count : 16 * count]]
    logits = [logit(o, 256) for o in body[16 * count : 17 * count]]
    colours = rows(list(struct.unpack_from(f"<{3 * k * count}f", body, 17 * count)), 3)
    by_gaussian = [colours[i : i + k] for i in range(0, len(colours), k)]
    means, scales = rows(halves[: 3 * count], 3), rows(halves[3 * count :], 3)
    return means, scales, rows(turns, 4), logits, by_gaussian


def compact(body: bytes, count: int, k: int) -> Parts:
    assert len(body) >= 48
    numbers = struct.unpack_from("<9fHHII", body)
    assert all(map(math.isfinite, numbers))
    origin, (p_step, s_base, s_step, r_step, c_base, c_step) = numbers[:3], numbers[3:9]
    levels, half, escapes, low_bit_bytes = numbers[9:]
    assert 2 <= levels <= 256
    assert 1 <= half <= 127
    assert escapes <= count
    n = count - escapes
    num_planes = 8 + 3 * k
    planes = [body[48 + p * n : 48 + (p + 1) * n] for p in range(num_planes)]
    at = 48 + num_planes * n
    assert len(body) >= at + low_bit_bytes
    low_bits = int.from_bytes(body[at : at + low_bit_bytes], "little")
    at += low_bit_bytes
    parts: Parts = ([], [], [], [], [])
    means, scales, quats, logits, sh = parts
    code = 0
    used = 0
    for i in range(n):
        length = planes[0][i]
        assert length <= 60
        if length:
            width = length - 1
            code += (1 << width) | (low_bits >> used) & ((1 << width) - 1)
            used += width
        assert code < 1 << 60
        place = [sum((code >> (3 * b + axis) & 1) << b for b in range(20)) for axis in range(3)]
        means.append(tuple(f32(f32(q * p_step) + o) for q, o in zip(place, origin, strict=True)))

        q1 = planes[1][i]
        q2 = q1 - planes[2][i]
        q3 = q2 - planes[3][i]
        scales.append(tuple(f32(f32(q * s_step) + s_base) for q in (q1, q2, q3)))

        x, y, z = (f32((planes[p][i] - half) * r_step) for p in (4, 5, 6))
        square = f32(f32(f32(x * x) + f32(y * y)) + f32(z * z))
        quats.append((f32(math.sqrt(max(f32(1 - square), 0.0))), x, y, z))

        assert planes[7][i] < levels
        logits.append(logit(planes[7][i], levels))

        colour: list[tuple[float, ...]] = []
        for c in range(k):
            luma = f32((planes[8 + c][i] - 128) * c_step)
            if c == 0:
                luma = f32(f32(planes[8][i] * c_step) + c_base)
            co = f32((planes[8 + k + c][i] - 128) * c_step)
            cg = f32((planes[8 + 2 * k + c][i] - 128) * c_step)
            rest = f32(luma - cg)
            colour.append((f32(rest + co), f32(luma + cg), f32(rest - co)))
        sh.append(colour)
    assert (used + 7) // 8 == low_bit_bytes
    assert low_bits >> used == 0
    tail = raw(body[at:], escapes, k)
    return means + tail[0], scales + tail[1], quats + tail[2], logits + tail[3], sh + tail[4]
