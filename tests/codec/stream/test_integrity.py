"""The rules by which the parts of a stream agree: each breach is found, at its place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from codec.coders.coder import EncodedChunk
from codec.errors import CodecError, CorruptError
from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.splats import Splats
from codec.stream.chunk import Chunk, decode_chunk, encode_chunk
from codec.stream.index import SegmentRecord, pack_record, record_bytes
from codec.stream.integrity import (
    CheckedObject,
    check_chunk,
    check_index_end,
    check_object_bytes,
    check_slice_size,
    decode_fitting_chunk,
    decode_fitting_packet,
    fitting_slice,
    object_table,
    read_index,
)
from codec.stream.object import (
    MAX_OBJECT_BYTES,
    encode_object,
    encode_packet,
    join_packets,
    read_object_table,
)
from tests.support.hostile import record_of
from tests.support.tiny_stream import SLICE_SIZE, tiny_manifest, tiny_slice

MANIFEST = tiny_manifest(Profile.RAW)  # windows of 3, segments of 4, two layers
BIRTHS = range(4, 8)
SIZE = record_bytes(2)


def chunk_of(birth: int, layer: int = 0, profile: Profile = Profile.RAW) -> EncodedChunk:
    return encode_chunk(tiny_slice(birth), layer, profile)


def object_of(births: range | list[int] = BIRTHS) -> bytes:
    return encode_object([chunk_of(birth) for birth in births])


OBJECT = object_of()
RECORD = record_of(1, 4, (OBJECT, OBJECT))


def records(*num_frames: int) -> list[SegmentRecord]:
    return [record_of(n, frames, (b"", b"")) for n, frames in enumerate(num_frames)]


def packed(*wanted: SegmentRecord) -> bytes:
    return b"".join(map(pack_record, wanted))


def test_an_index_that_fits_comes_back_in_any_parts() -> None:
    whole = records(4, 4, 2)
    assert str(read_index(packed(*whole), MANIFEST)) == str(whole)
    for known in range(4):
        found = read_index(packed(*whole[known:]), MANIFEST, whole[:known])
        assert str(found) == str(whole[known:])


@pytest.mark.parametrize(
    ("last", "field", "message"),
    [
        (replace(records(4, 4)[1], num_frames=5), 8, "segment 1 does not fit the manifest"),
        (replace(records(4, 4)[1], first_frame=5), 4, "segment 1 does not fit the manifest"),
        (replace(records(4, 4)[1], object_bytes=(1, MAX_OBJECT_BYTES + 1)), 60, "too large"),
        (replace(records(4, 4)[1], segment=2), 0, "describes 2"),
    ],
)
def test_a_record_that_breaks_a_rule(last: SegmentRecord, field: int, message: str) -> None:
    first = records(4)
    for known in (0, 1):
        with pytest.raises(CorruptError, match=message) as caught:
            read_index(packed(*first[known:], last), MANIFEST, first[:known])
        assert caught.value.at == SIZE * (1 - known) + field


@pytest.mark.parametrize("known", [0, 1])
def test_nothing_follows_a_short_segment(known: int) -> None:
    for first_frame in (3, 4):
        both = [records(3)[0], replace(records(4, 4)[1], first_frame=first_frame)]
        with pytest.raises(CorruptError, match="follows a short one") as caught:
            read_index(packed(*both[known:]), MANIFEST, both[:known])
        assert caught.value.at == SIZE * (1 - known)


def test_only_the_index_of_a_live_stream_may_have_a_torn_end() -> None:
    finished = MANIFEST.with_live(False)
    check_index_end(2 * SIZE, finished, 2)
    check_index_end(2 * SIZE + 9, MANIFEST.with_live(True), 2)
    with pytest.raises(CorruptError, match="9 bytes after the last whole record") as caught:
        check_index_end(2 * SIZE + 9, finished, 2)
    assert caught.value.at == 2 * SIZE


@pytest.mark.parametrize(
    ("data", "message", "at"),
    [
        (OBJECT[:-3], "bytes, the index says", len(OBJECT) - 3),
        (OBJECT + b"more", "bytes, the index says", len(OBJECT)),
        (OBJECT[:-1] + bytes([OBJECT[-1] ^ 1]), "was altered: its hash differs", None),
    ],
)
def test_size_and_hash_are_those_of_the_index(data: bytes, message: str, at: int | None) -> None:
    check_object_bytes(OBJECT, RECORD, 0)
    with pytest.raises(CorruptError, match=message) as caught:
        check_object_bytes(data, RECORD, 0)
    assert caught.value.at == at
    with pytest.raises(CorruptError, match=message) as caught:
        CheckedObject.check("there", data, MANIFEST, RECORD, 0)
    assert str(caught.value).startswith("there: ")
    assert caught.value.at == at


@pytest.mark.parametrize(
    ("births", "at"),
    [
        ([5, 6, 7, 8], 20),
        ([4, 5, 6, 8], 20 + 3 * 12),
        ([4, 5, 6], 16),  # the count
        ([4, 5, 6, 7, 8], 16),
    ],
)
def test_the_births_are_those_of_the_segment(births: list[int], at: int) -> None:
    data = object_of(births)
    with pytest.raises(CorruptError, match=r"its births are not 4\.\.7") as caught:
        object_table(data, MANIFEST, record_of(1, 4, (data, data)), 0)
    assert caught.value.at == at


def test_the_table_ends_where_the_object_does() -> None:
    """An index that names more than the object would hide what lies behind it."""
    data = OBJECT + b"hidden"
    record = record_of(1, 4, (data, data))
    check_object_bytes(data, record, 0)
    with pytest.raises(CorruptError, match=r"its table says \d+ bytes, the index") as caught:
        object_table(data, MANIFEST, record, 0)
    assert caught.value.at == 20 + 4 * 12 - 4
    assert object_table(OBJECT, MANIFEST, RECORD, 0) == tuple(read_object_table(OBJECT))


@pytest.mark.parametrize(
    ("chunk", "message", "at"),
    [
        (chunk_of(5), "birth 5 where birth 4 belongs", 8),
        (chunk_of(4, layer=1), "layer 1 where layer 0 belongs", 16),
        (chunk_of(4, profile=Profile.PAPER), "profile paper where profile raw belongs", 6),
    ],
)
def test_a_chunk_is_what_the_manifest_says(chunk: EncodedChunk, message: str, at: int) -> None:
    decoded = decode_chunk(chunk.data)
    with pytest.raises(CorruptError, match=message) as caught:
        check_chunk(decoded, MANIFEST, 4, 0)
    assert caught.value.at == at
    packet = encode_packet(chunk)
    with pytest.raises(CorruptError, match=message) as caught:
        decode_fitting_packet(packet, MANIFEST, 4, 0)
    assert caught.value.at == at
    # In an object the place is that of the packet, for nothing else can be pointed at.
    data = join_packets([(4, packet)])
    (entry,) = read_object_table(data)
    with pytest.raises(CorruptError) as caught:
        decode_fitting_chunk(data, entry, MANIFEST, 0)
    assert caught.value.at == entry.offset
    told = "birth 5 where the table says 4" if at == 8 else f"{message} (chunk of birth 4, "
    assert told in str(caught.value)


def test_a_chunk_of_a_lower_degree_does_not_fit() -> None:
    """A higher one is refused before it is decoded, by the bounds that the manifest sets."""
    manifest = replace(MANIFEST, sh_degree=1)
    with pytest.raises(CorruptError, match="SH degree 0 where SH degree 1 belongs") as caught:
        check_chunk(decode_chunk(chunk_of(4).data), manifest, 4, 0)
    assert caught.value.at == 17


def layers_of(*counts: int) -> list[Chunk]:
    slices = [Slice(4, Splats.empty(), np.zeros(0, np.uint8)), tiny_slice(4)]
    return [Chunk(4, n, Profile.RAW, slices[count > 0]) for n, count in enumerate(counts)]


def test_a_slice_has_no_more_gaussians_than_the_manifest_allows() -> None:
    fits = fitting_slice(layers_of(0, SLICE_SIZE, 0), MANIFEST, str)
    assert len(fits.splats) == SLICE_SIZE
    taken = []

    def taking() -> Iterator[Chunk]:
        for chunk in layers_of(0, SLICE_SIZE, SLICE_SIZE, 0, 0):
            taken.append(chunk.layer)
            yield chunk

    with pytest.raises(CorruptError, match=r"^layer 2: the slice born at 4 has 80 Gaussians, "):
        fitting_slice(taking(), MANIFEST, lambda layer: f"layer {layer}")
    # What comes behind is not even decoded.
    assert taken == [0, 1, 2]
    check_slice_size(4, SLICE_SIZE, MANIFEST)
    with pytest.raises(CodecError, match="the manifest allows 40"):
        check_slice_size(4, SLICE_SIZE + 1, MANIFEST)


def test_a_checked_object_gives_packets_and_chunks_by_birth() -> None:
    found = CheckedObject.check("there", OBJECT, MANIFEST, RECORD, 0)
    for birth in BIRTHS:
        assert found.packet(birth) == encode_packet(chunk_of(birth))
        assert found.chunk(birth).birth == birth
    layer_1 = CheckedObject.check("there", OBJECT, MANIFEST, RECORD, 1)
    with pytest.raises(CorruptError, match=r"^there: byte 68: chunk: layer 0 where") as caught:
        layer_1.chunk(4)
    assert caught.value.at == 20 + 4 * 12
