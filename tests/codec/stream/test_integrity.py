"""Rules of consistency between the parts of a stream: each breach is found at its place."""

from __future__ import annotations

from dataclasses import replace

import pytest

from codec.errors import CorruptError
from codec.stream.index import SegmentRecord, pack_record, record_bytes
from codec.stream.integrity import (
    CheckedObject,
    check_index_end,
    check_object_bytes,
    object_table,
    read_index,
)
from codec.stream.manifest import MASKS, Part, snapshot_part
from codec.stream.object import MAX_OBJECT_BYTES, encode_packet, join_packets, read_object_table
from tests.support.hostile import record_of
from tests.support.objects import new_chunk, object_of
from tests.support.tiny_stream import tiny_manifest

MANIFEST = tiny_manifest()  # windows of 3, segments of 4, two layers
BIRTHS = range(4, 8)
SIZE = record_bytes(2)
NUM_PARTS = len(MANIFEST.parts)

CHUNKS = {birth: new_chunk(birth, 12) for birth in range(9)}
OBJECT = object_of([CHUNKS[birth] for birth in BIRTHS])
SNAPSHOT = object_of([CHUNKS[4]])


def record_with(data: bytes) -> SegmentRecord:
    """The record of segment 1 with `data` as all its objects."""
    return record_of(1, 4, (data,) * NUM_PARTS)


RECORD = record_with(OBJECT)


def records(*num_frames: int) -> list[SegmentRecord]:
    return [record_of(n, frames, (b"",) * NUM_PARTS) for n, frames in enumerate(num_frames)]


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
        (
            replace(records(4, 4)[1], side_bytes=(1, 1, MAX_OBJECT_BYTES + 1)),
            16 + 2 * 44 + 2 * 40,
            "too large",
        ),
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


@pytest.mark.parametrize("part", [0, 1, MASKS])
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
def test_a_snapshot_is_that_of_the_first_frame(births: list[int], at: int) -> None:
    part = snapshot_part(1)
    assert len(object_table(SNAPSHOT, MANIFEST, record_with(SNAPSHOT), part)) == 1
    data = object_of([CHUNKS[birth] for birth in births])
    with pytest.raises(CorruptError, match=r"its births are not 4\.\.4") as caught:
        object_table(data, MANIFEST, record_with(data), part)
    assert caught.value.at == at


@pytest.mark.parametrize("part", [0, MASKS])
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


@pytest.mark.parametrize("part", [0, MASKS, snapshot_part(0)])
def test_a_packet_holds_no_more_than_its_slots_fill(part: Part) -> None:
    """The place of the error is that of the packet, because nothing smaller is known."""
    most = MANIFEST.max_content_bytes(part)
    for size in (most, most + 1):
        packet = encode_packet(replace(CHUNKS[4], data=bytes(size), edges=()))
        data = join_packets([(4, packet)])
        found = CheckedObject.check("there", data, MANIFEST, record_with(data), part)
        if size == most:
            assert len(found.content(4)) == most
            continue
        with pytest.raises(CorruptError, match=f"^there: byte 32: packet: {size} bytes") as caught:
            found.content(4)
        assert caught.value.at == 32
