"""index.bin, and what must agree between the parts of a stream: each breach at its place."""

from __future__ import annotations

import hashlib
import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import replace

import pytest

from codec.errors import CorruptError, InvalidError
from codec.stream.integrity import (
    CheckedObject,
    check_index_end,
    check_object_bytes,
    object_table,
    read_index,
)
from codec.stream.manifest import SKIP_MAPS, Part, keyframe_part
from codec.stream.segment import (
    CHECKSUM,
    HEAD,
    LAYER,
    MAX_OBJECT_BYTES,
    SIDE,
    SegmentRecord,
    encode_packet,
    join_packets,
    pack_record,
    parse_index,
    read_object_table,
    record_bytes,
)
from tests.support.hostile import flips, refused
from tests.support.objects import new_chunk, object_of
from tests.support.tiny_stream import tiny_manifest

MANIFEST = tiny_manifest()  # windows of 3, segments of 4, two layers
BIRTHS = range(4, 8)
SIZE = record_bytes(2)
NUM_PARTS = len(MANIFEST.parts)

CHUNKS = {birth: new_chunk(birth, 12) for birth in range(9)}
OBJECT = object_of([CHUNKS[birth] for birth in BIRTHS])
KEYFRAME = object_of([CHUNKS[4]])


def forged_record(record: SegmentRecord) -> bytes:
    """A record of the index with a correct checksum, even if the record breaks a rule."""
    layers = zip(record.object_bytes, record.object_sha256, record.psnr_db, strict=True)
    sides = zip(record.side_bytes, record.side_sha256, strict=True)
    body = HEAD.pack(record.segment, record.first_frame, record.num_frames, 0)
    body += b"".join(LAYER.pack(*layer) for layer in layers)
    body += b"".join(SIDE.pack(*side) for side in sides)
    return body + CHECKSUM.pack(zlib.crc32(body))


def record_of(segment: int, num_frames: int, objects: Sequence[bytes]) -> SegmentRecord:
    """The record of a segment in a stream with segments of 4 frames; `objects` are in the order of
    `Manifest.parts`."""
    num_layers = (len(objects) - 1) // 2
    sizes = tuple(map(len, objects))
    hashes = tuple(hashlib.sha256(data).digest() for data in objects)
    return SegmentRecord(
        segment,
        4 * segment,
        num_frames,
        sizes[:num_layers],
        hashes[:num_layers],
        (math.nan,) * num_layers,
        sizes[num_layers:],
        hashes[num_layers:],
    )


def record_with(data: bytes) -> SegmentRecord:
    """The record of segment 1 with `data` as all its objects."""
    return record_of(1, 4, (data,) * NUM_PARTS)


RECORD = record_with(OBJECT)


def records(*num_frames: int) -> list[SegmentRecord]:
    return [record_of(n, frames, (b"",) * NUM_PARTS) for n, frames in enumerate(num_frames)]


def packed(*wanted: SegmentRecord) -> bytes:
    return b"".join(map(forged_record, wanted))


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
        (
            replace(records(4, 4)[1], side_bytes=(1, 1, MAX_OBJECT_BYTES + 1)),
            16 + 2 * 44 + 2 * 40,
            "too large",
        ),
        (replace(records(4, 4)[1], segment=2), 0, "describes 2"),
        (replace(records(4, 4)[1], num_frames=0), 8, "segment 1"),
        (replace(records(4, 4)[1], psnr_db=(30.0, float("inf"))), 16 + 44 + 40, "segment 1"),
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
    assert refused(CorruptError, message, check_object_bytes, data, RECORD, 0).at == at
    error = refused(CorruptError, message, CheckedObject.check, "there", data, MANIFEST, RECORD, 0)
    assert str(error).startswith("there: ")
    assert error.at == at


@pytest.mark.parametrize("part", [0, 1, SKIP_MAPS])
def test_the_births_are_some_of_the_segment(part: Part) -> None:
    for births in ([], [4], [7], [4, 6], list(BIRTHS)):
        data = object_of([CHUNKS[birth] for birth in births])
        found = object_table(data, MANIFEST, record_with(data), part)
        assert [entry.birth for entry in found] == births
    for births, wrong in (([3], 0), ([4, 5, 6, 7, 8], 4), ([5, 8], 1), ([0, 4], 0)):
        data = object_of([CHUNKS[birth] for birth in births])
        message = rf"birth {births[wrong]} is not one of 4\.\.7"
        with pytest.raises(CorruptError, match=message) as caught:
            object_table(data, MANIFEST, record_with(data), part)
        assert caught.value.at == 20 + 12 * wrong


@pytest.mark.parametrize(("births", "at"), [([], 16), ([5], 20), ([4, 5], 16)])
def test_a_keyframe_is_that_of_the_first_frame(births: list[int], at: int) -> None:
    part = keyframe_part(1)
    assert len(object_table(KEYFRAME, MANIFEST, record_with(KEYFRAME), part)) == 1
    data = object_of([CHUNKS[birth] for birth in births])
    with pytest.raises(CorruptError, match=r"its births are not 4\.\.4") as caught:
        object_table(data, MANIFEST, record_with(data), part)
    assert caught.value.at == at


@pytest.mark.parametrize("part", [0, SKIP_MAPS])
def test_the_table_ends_where_the_object_does(part: Part) -> None:
    """An index with a larger object would hide the data behind the table's end."""
    data = OBJECT + b"hidden"
    record = record_with(data)
    check_object_bytes(data, record, MANIFEST.part_number(part))
    with pytest.raises(CorruptError, match=r"its table says \d+ bytes, the index") as caught:
        object_table(data, MANIFEST, record, part)
    assert caught.value.at == 20 + 4 * 12 - 4
    assert object_table(OBJECT, MANIFEST, RECORD, part) == tuple(read_object_table(OBJECT))
    empty = join_packets([])
    with pytest.raises(CorruptError, match="its table says 20 bytes, the index 26") as caught:
        object_table(empty + b"hidden", MANIFEST, record_with(empty + b"hidden"), part)
    assert caught.value.at == 16


def test_a_checked_object_gives_packets_and_chunks_by_birth() -> None:
    data = object_of([CHUNKS[5], CHUNKS[7]])
    found = CheckedObject.check("there", data, MANIFEST, record_with(data), 0)
    for birth in BIRTHS:
        is_there = birth in (5, 7)
        assert found.packet(birth) == (encode_packet(CHUNKS[birth]) if is_there else b"")
        assert found.content(birth) == (CHUNKS[birth].data if is_there else b"")
    error = CorruptError("what is wrong", 3)
    [first, _] = found.entries
    blamed = found.blamed(error, 5)
    assert str(blamed).startswith(f"there: byte {first.offset}: what is wrong (chunk of birth 5, ")
    assert "byte 3 in it" in str(blamed)
    assert blamed.at == first.offset
    nowhere = found.blamed(error, 6)
    assert (str(nowhere), nowhere.at) == ("there: what is wrong (birth 6)", None)


@pytest.mark.parametrize("part", [0, SKIP_MAPS, keyframe_part(0)])
def test_a_packet_holds_no_more_than_its_slots_fill(part: Part) -> None:
    """The place of the error is that of the packet, because nothing smaller is known."""
    most = MANIFEST.max_content_bytes(part)
    for size in (most, most + 1):
        packet = encode_packet(replace(CHUNKS[4], data=bytes(size), edges=(), sh_degree=None))
        data = join_packets([(4, packet)])
        found = CheckedObject.check("there", data, MANIFEST, record_with(data), part)
        if size == most:
            assert len(found.content(4)) == most
            continue
        error = refused(CorruptError, f"^there: byte 32: packet: {size} bytes", found.content, 4)
        assert error.at == 32


LAYERS = 3


def record(segment: int, num_frames: int = 30) -> SegmentRecord:
    return SegmentRecord(
        segment,
        30 * segment,
        num_frames,
        tuple(1000 * segment + layer for layer in range(LAYERS)),
        tuple(bytes([segment, layer] * 16) for layer in range(LAYERS)),
        (30.5, 31.25, 32.0),
        tuple(500 * segment + number for number in range(LAYERS + 1)),
        tuple(bytes([segment, 9, number, 9] * 8) for number in range(LAYERS + 1)),
    )


RECORDS = [record(0), record(1), record(2, 7)]
INDEX = b"".join(map(pack_record, RECORDS))


def test_records_round_trip() -> None:
    assert parse_index(INDEX, LAYERS) == RECORDS
    assert parse_index(b"", LAYERS) == []
    unknown = replace(RECORDS[0], psnr_db=(math.nan,) * LAYERS)
    (found,) = parse_index(pack_record(unknown), LAYERS)
    assert all(math.isnan(psnr) for psnr in found.psnr_db)
    for layers in (0, 17):
        refused(InvalidError, "", record_bytes, layers)
    assert parse_index(INDEX[record_bytes(LAYERS) :], LAYERS, first_segment=1) == RECORDS[1:]


def test_the_record_is_pinned() -> None:
    assert [record_bytes(n) for n in (1, 4, 16)] == [60 + 84 * n for n in (1, 4, 16)]
    data = pack_record(RECORDS[2])
    assert struct.unpack_from("<IIII", data) == (2, 60, 7, 0)
    assert struct.unpack_from("<Q32sf", data, 16 + 44) == (2001, bytes([2, 1] * 16), 31.25)
    skip_maps = 16 + 44 * 3
    assert struct.unpack_from("<Q32s", data, skip_maps) == (1000, bytes([2, 9, 0, 9] * 8))
    assert struct.unpack_from("<Q32s", data, skip_maps + 3 * 40) == (1003, bytes([2, 9, 3, 9] * 8))
    assert struct.unpack_from("<I", data, skip_maps + 4 * 40) == (zlib.crc32(data[:-4]),)


def test_only_the_keyframes_of_the_first_segment_are_played() -> None:
    assert RECORDS[1].part_bytes == (1000, 1001, 1002, 500, 501, 502, 503)
    assert RECORDS[1].played_bytes == 1000 + 1001 + 1002 + 500
    assert RECORDS[0].played_bytes == sum(RECORDS[0].part_bytes)
    assert len(RECORDS[0].part_sha256) == len(RECORDS[0].part_bytes)


def test_a_torn_last_record_is_left_out_at_any_byte() -> None:
    size = record_bytes(LAYERS)
    for length in range(len(INDEX)):
        assert parse_index(INDEX[:length], LAYERS) == RECORDS[: length // size]
    assert parse_index(INDEX + bytes(size), LAYERS) == RECORDS
    assert parse_index(INDEX + bytes(size - 1), LAYERS) == RECORDS


def test_any_altered_byte_is_found() -> None:
    for altered in flips(INDEX):
        refused(CorruptError, "segment", parse_index, altered, LAYERS)


@pytest.mark.parametrize(
    "wrong",
    [
        replace(RECORDS[0], object_bytes=(1, 2)),
        replace(RECORDS[0], object_bytes=(1, -2, 3)),
        replace(RECORDS[0], object_sha256=(b"short",) * LAYERS),
        replace(RECORDS[0], side_bytes=(1, 2, 3), side_sha256=(bytes(32),) * 3),
        replace(RECORDS[0], side_bytes=(1, 2, 3, -4)),
        replace(RECORDS[0], side_sha256=(b"short",) * (LAYERS + 1)),
        replace(RECORDS[0], num_frames=1 << 32),
        replace(RECORDS[0], psnr_db=(1e300,) * LAYERS),
        replace(RECORDS[0], psnr_db=(30.0, math.inf, 30.0)),
        replace(RECORDS[0], psnr_db=(-math.inf, math.nan, 30.0)),
    ],
)
def test_what_does_not_fit_is_not_packed(wrong: SegmentRecord) -> None:
    refused(InvalidError, "", pack_record, wrong)
