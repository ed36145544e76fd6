"""Responses of any server that follows the format: layers that arrive separately, late or never,
and connections that break.

There are no sockets here; the records are made from the packets on disk.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CodecError, CorruptError
from codec.framerange import FrameRange
from codec.slice import Slice
from codec.stream import StreamReader
from codec.stream.playrecord import KeyframeRecord, SliceRecord
from player.playout.assembler import Assembler
from player.playout.timeline import PlayedMedia
from player.source.served import PlayReceiver
from player.source.source import Packets
from server.abr.holding import Holding
from tests.support.delivery.playrecords import keyframe_record, slice_record
from tests.support.drawn import same_splats
from tests.support.hostile import flips
from tests.support.slots.slot_streams import Shown, gaussians, write_slot_stream
from tests.support.slots.updates import small_layout

NUM_FRAMES = 24
SWIN_SIZE, SEGMENT_FRAMES, LAYERS = 3, 5, 3


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> StreamReader:
    layout = small_layout(SWIN_SIZE, (5, 4, 6), 0, SEGMENT_FRAMES)
    path = write_slot_stream(tmp_path_factory.mktemp("streams") / "s", NUM_FRAMES, layout)
    return StreamReader(path)


Sent = SliceRecord | KeyframeRecord


def response(reader: StreamReader, frame: int, rng: np.random.Generator) -> Iterator[Sent]:
    """Records that a server may send from `frame` on: layer 0 in order, and any packets of the
    other layers, each once, at any time after it could be made."""
    start = frame // SEGMENT_FRAMES * SEGMENT_FRAMES
    first = start + 1
    leaves_out, delays = rng.choice([0.0, 0.2, 0.6]), rng.choice([0, 2, 9])
    waiting: list[tuple[int, Sent]] = []
    together = int(rng.integers(1, LAYERS + 1))
    yield keyframe_record(reader, start, 0, together)
    for layer in range(together, LAYERS):
        if rng.random() >= leaves_out:
            late = first + int(rng.integers(delays + 1))
            waiting.append((late, keyframe_record(reader, start, layer, layer + 1)))
    for birth in range(first, NUM_FRAMES):
        if birth % SEGMENT_FRAMES == 0 and rng.random() < 0.5:
            layer = int(rng.integers(LAYERS))
            record = keyframe_record(reader, birth, layer, LAYERS)
            waiting.append((birth + int(rng.integers(-2, delays + 1)), record))
        together = int(rng.integers(1, LAYERS + 1))
        for layer in range(together, LAYERS):
            if rng.random() >= leaves_out:
                late = birth + int(rng.integers(delays + 1))
                waiting.append((late, slice_record(reader, birth, layer, layer + 1)))
        yield slice_record(reader, birth, 0, together)
        yield from (record for at, record in waiting if at <= birth)
        waiting = [(at, record) for at, record in waiting if at > birth]


class Screen:
    """Shows the slices of an assembler, and compares them with the stream."""

    def __init__(self, reader: StreamReader) -> None:
        self._reader, self._shown = reader, Shown(reader.manifest)
        self._whole: dict[int, int] = {}  # by lane: number of complete layers that show

    def put(self, frame: int, slices: Sequence[Slice], whole: int) -> None:
        """Shows the next frame; checks that the complete layers of each lane are there, and that
        there is nothing that the stream does not have.

        whole: number of complete layers in this frame. A repair shows lane by lane, with the next
        slice of each lane.
        """
        splats = self._shown.after(slices, frame)
        self._whole |= {slice.birth % SWIN_SIZE: whole for slice in slices}
        self._whole = {lane: min(before, whole) for lane, before in self._whole.items()}
        everything = self._reader.active_splats(frame, LAYERS)
        assert gaussians(splats) <= gaussians(everything)
        least: Counter[bytes] = Counter()
        for one in self._reader.window(frame, LAYERS):
            end = self._reader.manifest.slot_layout.row_edges[self._whole[one.birth % SWIN_SIZE]]
            rows = np.flatnonzero(one.active(frame, SWIN_SIZE))
            least += gaussians(one.splats.take(rows[rows < end]))
        assert least <= gaussians(splats)
        if set(self._whole.values()) == {LAYERS}:
            assert same_splats(splats, everything)


@given(first=st.integers(0, NUM_FRAMES - 1), seed=st.integers(0, 1 << 32))
@settings(max_examples=25, deadline=None)
def test_whatever_comes_late_or_never_only_what_is_known_shows(
    reader: StreamReader, first: int, seed: int
) -> None:
    """A frame shows as soon as its layer 0 is there, with the data that has arrived by then."""
    rng = np.random.default_rng(seed)
    breaks = rng.choice([0.0, 0.02, 0.1])
    manifest = reader.manifest
    receiver = PlayReceiver("S", manifest, LAYERS, FrameRange(first))
    assembler = Assembler(manifest, LAYERS, first)
    holding = Holding(PlayedMedia(manifest), first)
    seen = Holding(PlayedMedia(manifest), first)
    screen = Screen(reader)
    frame, waiting = first, list[Packets]()
    while frame < NUM_FRAMES:
        asked = first if frame == first else receiver.rejoin(NUM_FRAMES)
        for record in response(reader, asked, rng):
            one = receiver.ingest(record)
            if one is None:  # it arrived before the break
                continue
            waiting.append(one)
            one.add_to(holding)
            while frame < holding.end_frame:
                used = [p for p in waiting if p.first_frame <= frame]
                waiting = [p for p in waiting if p.first_frame > frame]
                for packets in used:
                    packets.add_to(seen)
                screen.put(frame, assembler.assemble(frame, used), seen.whole_layers(frame))
                frame += 1
            if rng.random() < breaks:
                break


def of_use(receiver: PlayReceiver, *records: Sent) -> list[Packets]:
    """Packets from `records`; asserts that all are useful."""
    taken = [receiver.ingest(record) for record in records]
    assert None not in taken
    return [packets for packets in taken if packets is not None]


def assemble(reader: StreamReader, *records: Sent) -> list[int]:
    """Births of the slices that frames 6 and 7 use, from records after a valid start."""
    receiver = PlayReceiver("S", reader.manifest, LAYERS, FrameRange(6))
    start = keyframe_record(reader, 5, 0, 1), slice_record(reader, 6, 0, 1)
    assembler = Assembler(reader.manifest, LAYERS, 6)
    made = assembler.assemble(6, of_use(receiver, *start))
    made += assembler.assemble(7, of_use(receiver, *records))
    return [slice.birth for slice in made]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda r: SliceRecord(7, (b"",)), "born at 7 has no skip map"),
        (lambda r: SliceRecord(7, (), b""), "born at 7 has no layers"),
        (lambda r: slice_record(r, 8, 0, 1), "born at 8 arrived before the slice born at 7"),
        (lambda r: slice_record(r, 7, 0, 3), "a slice has layer 2; this play has 2 layers"),
        (lambda r: slice_record(r, 7, 2, 3), "a slice has layer 2; this play has 2 layers"),
        (lambda r: keyframe_record(r, 10, 1, 3), "a keyframe has layer 2; this play has 2 layers"),
        (lambda r: KeyframeRecord(6, 0, (b"",)), "frame 6 arrived, which does not begin a segment"),
    ],
)
def test_what_breaks_a_rule_is_named(
    reader: StreamReader, make: Callable[[StreamReader], Sent], message: str
) -> None:
    receiver = PlayReceiver("S", reader.manifest, 2, FrameRange(6))
    # A play begins with the keyframe of its segment.
    first = "layer 0 of the keyframe of frame 5"
    for record, refusal in (
        (slice_record(reader, 6, 0, 1), "the slice born at 6 arrived before a keyframe"),
        (keyframe_record(reader, 10, 0, 1), "begins with layer 0 of the keyframe of frame 10, not"),
        (keyframe_record(reader, 5, 1, 2), f"layer 1 of the keyframe of frame 5, not with {first}"),
    ):
        with pytest.raises(CorruptError, match=refusal):
            receiver.ingest(record)
    of_use(receiver, keyframe_record(reader, 5, 0, 1), slice_record(reader, 6, 0, 1))
    with pytest.raises(CorruptError, match=f"^S: .*{message}") as caught:
        receiver.ingest(make(reader))
    assert "\n" not in str(caught.value)
    # A refused record has changed nothing.
    assert receiver.ingest(slice_record(reader, 7, 0, 1)) is not None


def test_what_is_wrong_inside_is_named_when_it_is_due(reader: StreamReader) -> None:
    good, other = slice_record(reader, 7, 0, 1), slice_record(reader, 8, 0, 1)
    keyframe, late = keyframe_record(reader, 5, 1, 2), keyframe_record(reader, 10, 1, 2)
    skip_map, layer = "the skip map of the slice born at 7", "layer 0 of the slice born at 7"
    of = "of the keyframe of frame 5"
    for wrong, message in (
        (SliceRecord(7, (b"",), b"zz"), f"{skip_map}: packet"),
        (SliceRecord(7, (b"zz",), good.skip_map), f"{layer}: packet"),
        (SliceRecord(7, (b"",), other.skip_map), f"{skip_map}: byte 8: skip map: birth 8"),
        (SliceRecord(7, other.packets, good.skip_map), f"{layer}: byte 8: change: birth 8"),
        (KeyframeRecord(5, 1, (b"zz",)), f"layer 1 {of}: packet"),
        (KeyframeRecord(5, 2, keyframe.packets), f"layer 2 {of}: byte 5: keyframe: of layer 1"),
        (KeyframeRecord(5, 1, late.packets), f"layer 1 {of}: byte 8: keyframe: of frame 10"),
    ):
        records = [wrong, good] if isinstance(wrong, KeyframeRecord) else [wrong]
        with pytest.raises(CorruptError, match=f"^S: .*{message}"):
            assemble(reader, *records)


def test_any_bytes_give_slices_or_a_codec_error(reader: StreamReader) -> None:
    good = slice_record(reader, 7, 0, 1)
    assert good.skip_map is not None
    wrong: list[Sent] = [
        *(SliceRecord(7, good.packets, skip_map) for skip_map in flips(good.skip_map)),
        *(SliceRecord(7, (packet,), good.skip_map) for packet in flips(good.packets[0])),
    ]
    refused = 0
    for record in wrong:
        try:
            assemble(reader, record)
        except CodecError:
            refused += 1
    assert refused > len(wrong) // 2
