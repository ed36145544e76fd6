"""Responses of any server that keeps the format: layers that come and go, connections that break.

Nothing here has a socket; the records are made from the packets on disk.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CodecError, CorruptError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.manifest import MASKS, snapshot_part
from codec.stream.playrecord import SliceRecord, SnapshotRecord
from player.source.receiver import Receiver, open_receiver
from tests.support.hosted_streams import random_slice, small_manifest
from tests.support.hostile import flips
from tests.support.slots.screen import Screen
from tests.support.slots.slot_streams import write_slot_stream
from tests.support.slots.updates import small_layout

NUM_FRAMES = 24
SWIN_SIZE, SEGMENT_FRAMES, LAYERS = 3, 5, 3


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> StreamReader:
    layout = small_layout(SWIN_SIZE, (5, 4, 6), 0, SEGMENT_FRAMES)
    path = write_slot_stream(tmp_path_factory.mktemp("streams") / "s", NUM_FRAMES, layout)
    return StreamReader(path)


def slice_record(reader: StreamReader, birth: int, layers: int) -> SliceRecord:
    segment = reader.manifest.segment_of(birth)
    mask = reader.read_object(segment, MASKS).packet(birth)
    changes = (reader.read_object(segment, layer).packet(birth) for layer in range(layers))
    return SliceRecord(birth, tuple(changes), mask)


def snapshot_record(reader: StreamReader, frame: int, first: int, end: int) -> SnapshotRecord:
    segment = reader.manifest.segment_of(frame)
    parts = map(snapshot_part, range(first, end))
    found = (reader.read_object(segment, part).packet(frame) for part in parts)
    return SnapshotRecord(frame, first, tuple(found))


def snapshot_records(
    reader: StreamReader, frame: int, first: int, end: int, rng: np.random.Generator
) -> Iterator[SnapshotRecord]:
    """The snapshots of layers first..end-1 in one record or more."""
    while first < end:
        last = int(rng.integers(first, end)) + 1
        yield snapshot_record(reader, frame, first, last)
        first = last


def response(
    reader: StreamReader, frame: int, rng: np.random.Generator, fickle: bool
) -> Iterator[tuple[SliceRecord | SnapshotRecord, int]]:
    """What a server sends from `frame` on, each record with the layers that are whole after it.

    fickle: layers are dropped and taken up again.
    """
    start = frame // SEGMENT_FRAMES * SEGMENT_FRAMES
    held = int(rng.integers(1, LAYERS + 1)) if fickle else LAYERS
    for record in snapshot_records(reader, start, 0, held, rng):
        yield record, held
    for birth in range(start + 1, NUM_FRAMES):
        if fickle and rng.random() < 0.15:
            held = int(rng.integers(0, held + 1))
        yield slice_record(reader, birth, held), held
        if birth % SEGMENT_FRAMES == 0 and fickle:
            wanted = int(rng.integers(held, LAYERS + 1))
            for record in snapshot_records(reader, birth, held, wanted, rng):
                yield record, wanted
            held = wanted


@pytest.mark.parametrize("fickle", [False, True])
@given(first=st.integers(0, NUM_FRAMES - 1), seed=st.integers(0, 1 << 32))
@settings(max_examples=60, deadline=None)
def test_whatever_is_left_out_or_breaks_only_what_is_known_shows(
    reader: StreamReader, fickle: bool, first: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    breaks = rng.choice([0.0, 0.1, 0.3])
    receiver = open_receiver("S", reader.manifest, LAYERS, FrameRange(first))
    screen, frame = Screen(reader, first), first
    complete = False
    while not complete:
        held = before = 0
        for record, held in response(reader, frame, rng, fickle):
            if isinstance(record, SnapshotRecord):
                assert not list(receiver.take(record))
                screen.snapshots_came()
            else:
                for received in receiver.take(record):
                    # A snapshot is complete when the slice after it comes.
                    screen.put(received, before if received.slice.birth < record.birth else held)
            before = held
            if rng.random() < breaks:
                # The newest frames may not be known yet.
                known = max(receiver.next_birth, 0, int(rng.integers(first + 1, NUM_FRAMES + 1)))
                frame = receiver.rejoin(known)
                assert frame == max(first, min(receiver.next_birth, known - 1))
                break
        else:
            complete = True
            for received in receiver.finish():
                screen.put(received, held)
    assert receiver.next_birth == screen.next_birth == NUM_FRAMES


def receive(receiver: Receiver, *records: SliceRecord | SnapshotRecord) -> list[int]:
    return [one.slice.birth for record in records for one in receiver.take(record)]


def joined(reader: StreamReader, first: int = 6, layers: int = 2) -> Receiver:
    """One who has come to `first`, of the segment from 5 to 9, with layer 0."""
    receiver = open_receiver("S", reader.manifest, layers, FrameRange(first))
    receive(receiver, snapshot_record(reader, 5, 0, 1))
    for birth in range(6, first + 1):
        receive(receiver, slice_record(reader, birth, 1))
    return receiver


Make = Callable[[StreamReader], SliceRecord | SnapshotRecord]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda r: SliceRecord(7, (b"",)), "the slice born at 7 has no mask"),
        (lambda r: slice_record(r, 8, 1), "the slice born at 8 came before 7"),
        (lambda r: slice_record(r, 6, 1), "the slice born at 6 came before 7"),
        (lambda r: slice_record(r, 7, 3), "born at 7 has 3 layers, at most 2"),
        (lambda r: SliceRecord(7, (), b"zz"), "the mask of the slice born at 7: packet"),
        (
            lambda r: SliceRecord(7, (b"zz",), slice_record(r, 7, 1).mask),
            "layer 0 of the slice born at 7: packet",
        ),
        (
            lambda r: SliceRecord(7, (), slice_record(r, 8, 0).mask),
            "the mask of the slice born at 7: byte 8: mask: birth 8",
        ),
        (
            lambda r: SliceRecord(7, slice_record(r, 8, 1).packets, slice_record(r, 7, 0).mask),
            "layer 0 of the slice born at 7: byte 8: change: birth 8",
        ),
        (
            lambda r: snapshot_record(r, 10, 0, 1),
            "layer 0 of the snapshot of frame 10: snapshot: of frame 10, the slices .* to 6",
        ),
        (lambda r: snapshot_record(r, 5, 0, 1), "of frame 5, the slices have come to 6"),
        (
            lambda r: SnapshotRecord(6, 0, snapshot_record(r, 5, 0, 1).packets),
            "layer 0 of the snapshot of frame 6: byte 8: snapshot: of frame 5",
        ),
        (lambda r: SnapshotRecord(6, 3, (b"zz",)), "the stream has 3 layers"),
        (lambda r: SnapshotRecord(6, 0, (b"zz",)), "snapshot of frame 6: packet"),
    ],
)
def test_what_breaks_a_rule_is_named(reader: StreamReader, make: Make, message: str) -> None:
    receiver = joined(reader)
    with pytest.raises(CorruptError, match=f"^S: .*{message}") as caught:
        receive(receiver, make(reader))
    assert "\n" not in str(caught.value)
    # What was refused has altered nothing.
    assert receive(receiver, slice_record(reader, 7, 1)) == [7]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda r: slice_record(r, 6, 1), "the slice born at 6 came before a snapshot"),
        (lambda r: snapshot_record(r, 10, 0, 1), "of frame 10, the slices have come to 5"),
        (lambda r: snapshot_record(r, 5, 1, 2), "of layer 1 where that of 0 belongs first"),
    ],
)
def test_a_play_begins_with_the_snapshots_of_its_segment(
    reader: StreamReader, make: Make, message: str
) -> None:
    receiver = open_receiver("S", reader.manifest, 2, FrameRange(6))
    with pytest.raises(CorruptError, match=message):
        receive(receiver, make(reader))


def test_a_layer_that_nobody_wanted_is_refused(reader: StreamReader) -> None:
    receiver = open_receiver("S", reader.manifest, 2, FrameRange(5))
    with pytest.raises(CorruptError, match="of layer 2, at most 2 are wanted"):
        receive(receiver, snapshot_record(reader, 5, 0, 3))


def test_any_bytes_give_a_slice_or_a_codec_error(reader: StreamReader) -> None:
    whole = slice_record(reader, 7, 1)
    assert whole.mask is not None
    wrong: list[SliceRecord | SnapshotRecord] = [
        *(SliceRecord(7, whole.packets, mask) for mask in flips(whole.mask)),
        *(SliceRecord(7, (packet,), whole.mask) for packet in flips(whole.packets[0])),
    ]
    refused = 0
    for record in wrong:
        try:
            receive(joined(reader), record)
        except CodecError:
            refused += 1
    assert refused > len(wrong) // 2


def test_whole_slices_know_no_masks_and_no_snapshots(tmp_path: Path) -> None:
    receiver = open_receiver("S", small_manifest(), 3, FrameRange())
    with pytest.raises(CorruptError, match="a snapshot in a stream of whole slices"):
        receive(receiver, SnapshotRecord(0, 0, (b"",)))
    birth = random_slice(-3).birth
    with pytest.raises(CorruptError, match="S: the slice born at -3 has no layers"):
        receive(receiver, SliceRecord(birth, (), b"mask"))
