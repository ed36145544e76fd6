"""Responses of any server that keeps the format: layers that come apart, late or never, connections
that break.

Nothing here has a socket; the records are made from the packets on disk.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CodecError, CorruptError
from codec.framerange import FrameRange
from codec.slice import active_splats
from codec.stream import StreamReader
from codec.stream.manifest import MASKS, snapshot_part
from codec.stream.playrecord import SliceRecord, SnapshotRecord
from player.playout.assembler import open_assembler
from player.playout.timeline import PlayedMedia
from player.source.receiver import Receiver
from player.source.source import Packets
from server.abr.holding import SliceHolding
from server.abr.slotholding import open_holding
from tests.support.hosted_streams import random_slice, small_manifest, write_stream
from tests.support.hostile import flips
from tests.support.slots.screen import Screen
from tests.support.slots.slot_streams import Shown, same_splats, write_slot_stream
from tests.support.slots.updates import small_layout

NUM_FRAMES = 24
SWIN_SIZE, SEGMENT_FRAMES, LAYERS = 3, 5, 3


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> StreamReader:
    layout = small_layout(SWIN_SIZE, (5, 4, 6), 0, SEGMENT_FRAMES)
    path = write_slot_stream(tmp_path_factory.mktemp("streams") / "s", NUM_FRAMES, layout)
    return StreamReader(path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> StreamReader:
    """A stream of version 1."""
    path = tmp_path_factory.mktemp("whole") / "s"
    write_stream(path, NUM_FRAMES, 9, 0, swin_size=SWIN_SIZE, num_gs=9 * SWIN_SIZE)
    return StreamReader(path)


def slice_record(reader: StreamReader, birth: int, first: int, end: int) -> SliceRecord:
    segment = reader.manifest.segment_of(birth)
    parts = (reader.read_object(segment, layer).packet(birth) for layer in range(first, end))
    mask = None
    if reader.manifest.has_slots and not first:
        mask = reader.read_object(segment, MASKS).packet(birth)
    return SliceRecord(birth, tuple(parts), mask, first)


def snapshot_record(reader: StreamReader, frame: int, first: int, end: int) -> SnapshotRecord:
    segment = reader.manifest.segment_of(frame)
    parts = map(snapshot_part, range(first, end))
    found = (reader.read_object(segment, part).packet(frame) for part in parts)
    return SnapshotRecord(frame, first, tuple(found))


Sent = SliceRecord | SnapshotRecord


def response(reader: StreamReader, frame: int, rng: np.random.Generator) -> Iterator[Sent]:
    """What a server may send from `frame` on: layer 0 in order, of the others anything, each packet
    once, at any time after it could be made."""
    start = frame // SEGMENT_FRAMES * SEGMENT_FRAMES
    slots = reader.manifest.has_slots
    first = start + 1 if slots else frame - SWIN_SIZE + 1
    leaves_out, delays = rng.choice([0.0, 0.2, 0.6]), rng.choice([0, 2, 9])
    waiting: list[tuple[int, Sent]] = []
    if slots:
        together = int(rng.integers(1, LAYERS + 1))
        yield snapshot_record(reader, start, 0, together)
        for layer in range(together, LAYERS):
            if rng.random() >= leaves_out:
                waiting.append(
                    (
                        first + int(rng.integers(delays + 1)),
                        snapshot_record(reader, start, layer, layer + 1),
                    )
                )
    for birth in range(first, NUM_FRAMES):
        if slots and birth % SEGMENT_FRAMES == 0 and rng.random() < 0.5:
            layer = int(rng.integers(LAYERS))
            record = snapshot_record(reader, birth, layer, LAYERS)
            waiting.append((birth + int(rng.integers(-2, delays + 1)), record))
        together = int(rng.integers(1, LAYERS + 1))
        for layer in range(together, LAYERS):
            if rng.random() >= leaves_out:
                late = birth + int(rng.integers(delays + 1))
                waiting.append((late, slice_record(reader, birth, layer, layer + 1)))
        yield slice_record(reader, birth, 0, together)
        yield from (record for at, record in waiting if at <= birth)
        waiting = [(at, record) for at, record in waiting if at > birth]


@pytest.mark.parametrize("version", [1, 2])
@given(first=st.integers(0, NUM_FRAMES - 1), seed=st.integers(0, 1 << 32))
@settings(max_examples=60, deadline=None)
def test_whatever_comes_late_or_never_only_what_is_known_shows(
    reader: StreamReader, whole: StreamReader, version: int, first: int, seed: int
) -> None:
    """A frame shows as soon as layer 0 of it is there, with what has come by then."""
    stream, rng = (whole if version == 1 else reader), np.random.default_rng(seed)
    breaks = rng.choice([0.0, 0.02, 0.1])
    manifest = stream.manifest
    receiver = Receiver("S", manifest, LAYERS, FrameRange(first))
    assembler = open_assembler(manifest, LAYERS, first)
    holding = open_holding(PlayedMedia(manifest), first)
    seen = open_holding(PlayedMedia(manifest), first)
    screen, shown = Screen(stream, first), Shown(manifest)
    frame, waiting = first, list[Packets]()
    while frame < NUM_FRAMES:
        asked = first if frame == first else receiver.rejoin(NUM_FRAMES)
        for record in response(stream, asked, rng):
            one = receiver.take(record)
            if one is None:  # it came before the break
                continue
            waiting.append(one)
            one.add_to(holding)
            while frame < holding.end_frame:
                used = [p for p in waiting if p.first_frame <= frame]
                waiting = [p for p in waiting if p.first_frame > frame]
                for packets in used:
                    packets.add_to(seen)
                slices = assembler.take(frame, used)
                if version == 2:
                    screen.put(slices, round(seen.layers(frame)))
                else:
                    splats = shown.after(slices, frame)
                    assert isinstance(seen, SliceHolding)
                    expected = [
                        stream.slice(birth, seen.level(birth))
                        for birth in range(frame - SWIN_SIZE + 1, frame + 1)
                    ]
                    assert same_splats(splats, active_splats(expected, frame, SWIN_SIZE))
                frame += 1
            if rng.random() < breaks:
                break


def take(receiver: Receiver, *records: Sent) -> list[int]:
    return [packets.first_frame for packets in of_use(receiver, *records)]


def of_use(receiver: Receiver, *records: Sent) -> list[Packets]:
    """What is made of `records`, which are all of use."""
    taken = [receiver.take(record) for record in records]
    assert None not in taken
    return [packets for packets in taken if packets is not None]


Make = Callable[[StreamReader], Sent]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda r: SliceRecord(7, (b"",)), "the slice born at 7 has no mask"),
        (lambda r: SliceRecord(7, (), b""), "the slice born at 7 has no layers"),
        (
            lambda r: slice_record(r, 8, 0, 1),
            "the slice born at 8 arrived before the slice born at 7",
        ),
        (lambda r: slice_record(r, 7, 0, 3), "a slice has layer 2; this play has 2 layers"),
        (lambda r: slice_record(r, 7, 2, 3), "a slice has layer 2; this play has 2 layers"),
        (lambda r: snapshot_record(r, 10, 1, 3), "a snapshot has layer 2; this play has 2 layers"),
        (
            lambda r: SnapshotRecord(6, 0, (b"",)),
            "a snapshot of frame 6 arrived, which does not begin a segment",
        ),
    ],
)
def test_what_breaks_a_rule_is_named(reader: StreamReader, make: Make, message: str) -> None:
    receiver = Receiver("S", reader.manifest, 2, FrameRange(6))
    take(receiver, snapshot_record(reader, 5, 0, 1), slice_record(reader, 6, 0, 1))
    with pytest.raises(CorruptError, match=f"^S: .*{message}") as caught:
        take(receiver, make(reader))
    assert "\n" not in str(caught.value)
    # What was refused has altered nothing.
    assert take(receiver, slice_record(reader, 7, 0, 1)) == [7]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda r: slice_record(r, 6, 0, 1), "the slice born at 6 arrived before a snapshot"),
        (
            lambda r: snapshot_record(r, 10, 0, 1),
            "begins with layer 0 of the snapshot of frame 10, not",
        ),
        (
            lambda r: snapshot_record(r, 5, 1, 2),
            "layer 1 of the snapshot of frame 5, not with layer 0 of the snapshot of frame 5",
        ),
    ],
)
def test_a_play_begins_with_the_snapshot_of_its_segment(
    reader: StreamReader, make: Make, message: str
) -> None:
    receiver = Receiver("S", reader.manifest, 2, FrameRange(6))
    with pytest.raises(CorruptError, match=message):
        take(receiver, make(reader))


def assemble(reader: StreamReader, *records: Sent) -> list[int]:
    """The births of the slices that frames 6 and 7 take in, of records behind a good start."""
    receiver = Receiver("S", reader.manifest, LAYERS, FrameRange(6))
    start = snapshot_record(reader, 5, 0, 1), slice_record(reader, 6, 0, 1)
    assembler = open_assembler(reader.manifest, LAYERS, 6)
    made = assembler.take(6, of_use(receiver, *start))
    made += assembler.take(7, of_use(receiver, *records))
    return [slice.birth for slice in made]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda r: SliceRecord(7, (b"",), b"zz"), "the mask of the slice born at 7: packet"),
        (
            lambda r: SliceRecord(7, (b"zz",), slice_record(r, 7, 0, 1).mask),
            "layer 0 of the slice born at 7: packet",
        ),
        (
            lambda r: SliceRecord(7, (b"",), slice_record(r, 8, 0, 1).mask),
            "the mask of the slice born at 7: byte 8: mask: birth 8",
        ),
        (
            lambda r: SliceRecord(
                7, slice_record(r, 8, 0, 1).packets, slice_record(r, 7, 0, 1).mask
            ),
            "layer 0 of the slice born at 7: byte 8: change: birth 8",
        ),
    ],
)
def test_what_is_wrong_inside_is_named_when_it_is_due(
    reader: StreamReader, make: Make, message: str
) -> None:
    record = make(reader)
    with pytest.raises(CorruptError, match=f"^S: .*{message}"):
        assemble(reader, record)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda r: SnapshotRecord(5, 1, (b"zz",)), "layer 1 of the snapshot of frame 5: packet"),
        (
            lambda r: SnapshotRecord(5, 2, snapshot_record(r, 5, 1, 2).packets),
            "layer 2 of the snapshot of frame 5: byte 5: snapshot: of layer 1",
        ),
        (
            lambda r: SnapshotRecord(5, 1, snapshot_record(r, 10, 1, 2).packets),
            "layer 1 of the snapshot of frame 5: byte 8: snapshot: of frame 10",
        ),
    ],
)
def test_a_late_snapshot_that_is_wrong_is_named(
    reader: StreamReader, make: Make, message: str
) -> None:
    with pytest.raises(CorruptError, match=f"^S: .*{message}"):
        assemble(reader, make(reader), slice_record(reader, 7, 0, 1))


def test_any_bytes_give_slices_or_a_codec_error(reader: StreamReader) -> None:
    good = slice_record(reader, 7, 0, 1)
    assert good.mask is not None
    wrong: list[Sent] = [
        *(SliceRecord(7, good.packets, mask) for mask in flips(good.mask)),
        *(SliceRecord(7, (packet,), good.mask) for packet in flips(good.packets[0])),
    ]
    refused = 0
    for record in wrong:
        try:
            assemble(reader, record)
        except CodecError:
            refused += 1
    assert refused > len(wrong) // 2


def test_whole_slices_know_no_masks_and_no_snapshots() -> None:
    receiver = Receiver("S", small_manifest(), 3, FrameRange())
    with pytest.raises(CorruptError, match="a snapshot arrived, but the stream has whole slices"):
        take(receiver, SnapshotRecord(0, 0, (b"",)))
    birth = random_slice(-3).birth
    with pytest.raises(CorruptError, match="S: the slice born at -3 has no layers"):
        take(receiver, SliceRecord(birth, (), b"mask"))
