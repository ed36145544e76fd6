"""Packets of coded planes: the way there and back, agreement with the plain reader, any bytes."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.arrays import Bytes
from codec.coders.coder import EncodedChunk
from codec.coders.zstd import compress
from codec.errors import CodecError, CorruptError
from codec.lattice.lattice import bytes_per_gaussian, num_attributes
from codec.slots.changepacket import (
    FORM,
    change_content,
    encode_change_packet,
    renumbered_change,
    sealed,
)
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import Kind, SlotHeader, with_birth
from codec.stream.segment import encode_packet, packet_content
from tests.goldens.decoder import Unsupported
from tests.goldens.objects import inflate
from tests.support.hostile import flips, refused, survives, truncations, within_bytes
from tests.support.slots.trained_updates import trained_like_layout, trained_like_updates

LIMIT_BYTES = 1 << 20


def made_planes(rng: np.random.Generator, num_planes: int, count: int) -> Bytes:
    """Planes of all kinds: still, small or large numbers, noise, and a few of the largest."""
    planes = np.zeros((num_planes, count), np.uint8)
    for plane in planes:
        scale = rng.choice((0, 0.3, 2, 20, 200))
        plane[:] = np.minimum(rng.geometric(1 / (1 + scale), count) - 1, 255)
        plane[rng.random(count) < rng.choice((0, 0.1))] = 255
    return planes


def made_chunk(seed: int, sh_degree: int, num_predicted: int, num_new: int) -> bytes:
    """A change whose numbers fit each other, with noise where it may hold any bytes."""
    rng = np.random.default_rng(seed)
    num_planes = 3 + num_attributes(sh_degree)
    predicted, new = (made_planes(rng, num_planes, n) for n in (num_predicted, num_new))
    new[:3] %= 26
    longs = int((predicted[:3] == 255).sum())
    low_bit_bytes = (int(np.maximum(new[:3].astype(int) - 1, 0).sum()) + 7) // 8
    escapes = int(rng.integers(num_new + 1))
    has_starts = bool(rng.integers(2))
    behind = low_bit_bytes + (4 + bytes_per_gaussian(sh_degree)) * escapes + num_new * has_starts
    return b"".join([
        SlotHeader(Kind.CHANGE, int(rng.integers(16)), seed % 99 - 9, has_starts).pack(),
        struct.pack("<5I", num_predicted, num_new, longs, escapes, low_bit_bytes),
        predicted.tobytes(),
        rng.bytes(4 * longs),
        new.tobytes(),
        rng.bytes(behind),
    ])  # fmt: skip


COUNTS = st.sampled_from((0, 1, 2, 7, 60, 300))


@given(st.integers(0, 2**32 - 1), st.integers(0, 3), COUNTS, COUNTS)
@settings(max_examples=60)
def test_there_and_back(seed: int, sh_degree: int, num_predicted: int, num_new: int) -> None:
    chunk = made_chunk(seed, sh_degree, num_predicted, num_new)
    packet = encode_change_packet(chunk, sh_degree)
    assert change_content(packet, len(chunk)) == chunk == inflate(packet, len(chunk))
    refused(CorruptError, "", change_content, packet, len(chunk) - 1)
    other = renumbered_change(packet, 1234)
    assert change_content(other, len(chunk)) == with_birth(chunk, 1234)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_patterns_as_rare_as_can_be(seed: int) -> None:
    """A Huffman code of Fibonacci's numbers would be longer than 7 bits."""
    rng = np.random.default_rng(seed)
    counts = [1, 1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144, 233, 377, 610, 987]
    patterns = np.repeat(rng.permutation(16), counts)
    planes = np.zeros((13, len(patterns)), np.uint8)
    planes[[0, 1, 2, 12]] = patterns >> np.arange(4)[:, None] & 1
    chunk = SlotHeader(Kind.CHANGE, 0, 1).pack() + struct.pack("<5I", len(patterns), *[0] * 4)
    chunk += planes.tobytes()
    packet = encode_change_packet(chunk, 0)
    assert change_content(packet, len(chunk)) == chunk == inflate(packet, len(chunk))


@given(st.binary(max_size=80), st.integers(0, 7), st.sampled_from((40, 300, LIMIT_BYTES)))
@settings(max_examples=300)
def test_any_bytes_are_read_as_the_plain_reader_does(
    body: bytes, flags: int, limit_bytes: int
) -> None:
    packet = sealed(bytes([FORM, flags, 0, 0]) + bytes(4) + body)
    try:
        expected: bytes | None = inflate(packet, limit_bytes)
    except (AssertionError, Unsupported):
        expected = None
    try:
        found: bytes | None = change_content(packet, limit_bytes)
    except CodecError:
        found = None
    assert found == expected
    assert found is None or len(found) <= limit_bytes


def test_damaged_packets_are_refused() -> None:
    packet = encode_change_packet(made_chunk(1, 0, 9, 5), 0)
    for damaged in (*flips(packet), *truncations(packet)):
        assert not damaged or not survives(lambda data: packet_content(data, LIMIT_BYTES), damaged)


def test_memory_goes_by_what_the_caller_allows() -> None:
    """Counts of any size, and as many Gaussians without a bit as a megabyte has."""
    for count in (80_000, (1 << 31) - 1):
        bits = count.bit_length()
        numbers = (bits | count << 5).to_bytes(6, "little")
        packet = sealed(bytes([FORM, 0, 0, 0]) + bytes(4) + numbers + bytes(60))
        with within_bytes(3 * LIMIT_BYTES):
            refused(CorruptError, "", change_content, packet, LIMIT_BYTES)


def test_a_packet_takes_the_shorter_form() -> None:
    layout = trained_like_layout(400, 2, 30)
    encoder = SlotEncoder(layout)
    coded = framed = 0
    for update in trained_like_updates(layout, 4, 0.3):
        made = encoder.append(update)
        for chunk in made.changes if made and update.birth > 0 else ():
            packet = encode_packet(chunk)
            coded += len(packet)
            framed += len(compress(chunk.data, chunk.edges))
            assert packet[0] == FORM
            assert packet_content(packet, len(chunk.data)) == chunk.data
    assert coded < 0.9 * framed
    still = made_chunk(0, 0, 0, 0)[:12] + struct.pack("<5I", 0, 3000, 0, 0, 0) + bytes(13 * 3000)
    chunk = EncodedChunk(1, still, (0, len(still)), 0)
    assert encode_packet(chunk) == compress(still, chunk.edges)


@pytest.mark.parametrize("sh_degree", [0, 3])
def test_a_change_of_nothing(sh_degree: int) -> None:
    chunk = made_chunk(3, sh_degree, 0, 0)
    assert change_content(encode_change_packet(chunk, sh_degree), LIMIT_BYTES) == chunk
