"""A part of a stream: its frames are equal bit by bit, and its chunks are unchanged."""

from __future__ import annotations

from itertools import takewhile
from pathlib import Path

import pytest

from codec.errors import CorruptError, InvalidError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.manifest import MASKS
from codec.tools.audit import verify_stream
from codec.tools.cutting import trim_stream
from tests.support.slots.edited import (
    NUM_FRAMES,
    SEGMENT_FRAMES,
    frames_of,
    segment_files,
    write_trained_like,
)
from tests.support.slots.slot_streams import gaussians, write_slot_stream
from tests.support.slots.updates import small_layout


@pytest.mark.parametrize(("swin_size", "period"), [(1, 1), (3, 1), (6, 1), (1, 2), (1, 4)])
@pytest.mark.parametrize("frames", [(0, 4), (0, 14), (3, 4), (4, 14), (5, 11), (8, 11), (13, 14)])
def test_trimmed_frames(
    frames: tuple[int, int], swin_size: int, period: int, tmp_path: Path
) -> None:
    layout = small_layout(swin_size, (6, 4), 1, 4, period)
    source = write_slot_stream(tmp_path / "s", 14, layout, 3)
    trim_stream(source, tmp_path / "t", FrameRange(*frames))
    summary = verify_stream(tmp_path / "t")
    assert (summary.num_frames, summary.live) == (frames[1] - frames[0], False)
    manifest = StreamReader(tmp_path / "t").manifest
    assert (manifest.capture_frame, manifest.temporal_period) == (frames[0], period)
    wanted = list(frames_of(source))[slice(*frames)]
    for before, after in zip(wanted, frames_of(tmp_path / "t"), strict=True):
        assert gaussians(before) == gaussians(after)


def test_segments_that_keep_their_place_are_copied_byte_for_byte(tmp_path: Path) -> None:
    source = write_trained_like(
        tmp_path / "s", 5, 200, quality=lambda frame, slices: [20.0 + frame] * 4
    )
    made = trim_stream(source, tmp_path / "t", FrameRange(0, 2 * SEGMENT_FRAMES))
    assert (made.num_copied, made.num_renumbered, made.num_segments) == (2, 0, 2)
    files = segment_files(source)
    assert segment_files(tmp_path / "t") == {
        name: data for name, data in files.items() if not name.startswith("segments/2/")
    }
    assert StreamReader(tmp_path / "t").records == StreamReader(source).records[:2]


def test_segments_that_move_keep_their_chunks_but_for_the_frame_number(tmp_path: Path) -> None:
    source = write_trained_like(
        tmp_path / "s", 5, 200, quality=lambda frame, slices: [20.0 + frame] * 4
    )
    made = trim_stream(source, tmp_path / "t", FrameRange(SEGMENT_FRAMES))
    assert (made.num_copied, made.num_renumbered, made.num_segments) == (0, 2, 2)
    before, after = StreamReader(source), StreamReader(tmp_path / "t")
    assert after.num_frames == NUM_FRAMES - SEGMENT_FRAMES
    for segment in (0, 1):
        assert after.records[segment].psnr_db == before.records[segment + 1].psnr_db
        for part in before.manifest.parts:
            old, new = before.read_object(segment + 1, part), after.read_object(segment, part)
            moved = {entry.birth - SEGMENT_FRAMES for entry in old.entries}
            if part == MASKS or type(part) is int:
                moved -= {0}  # the content of that slice is in the snapshots
            assert {entry.birth for entry in new.entries} == moved
            for birth in moved:
                was, now = old.content(birth + SEGMENT_FRAMES), new.content(birth)
                assert (was[:8], was[12:]) == (now[:8], now[12:])
                assert int.from_bytes(now[8:12], "little") == birth
                assert len(new.packet(birth)) <= len(old.packet(birth + SEGMENT_FRAMES)) + 4


def test_the_planes_of_segments_that_move_are_the_same_bytes(tmp_path: Path) -> None:
    source = write_trained_like(tmp_path / "s", 1, 2000)
    trim_stream(source, tmp_path / "t", FrameRange(SEGMENT_FRAMES))
    verify_stream(tmp_path / "t")
    before, after = StreamReader(source), StreamReader(tmp_path / "t")
    num_bytes = num_same = 0
    for segment in (0, 1):
        for part in before.manifest.parts:
            old, new = before.read_object(segment + 1, part), after.read_object(segment, part)
            for entry in new.entries:
                packet = bytes(new.packet(entry.birth))[:-4]  # without the checksum
                was = bytes(old.packet(entry.birth + SEGMENT_FRAMES))[:-4]
                num_bytes += len(packet)
                pairs = zip(reversed(packet), reversed(was), strict=False)
                num_same += len(list(takewhile(lambda pair: pair[0] == pair[1], pairs)))
    assert num_same > 0.8 * num_bytes


@pytest.mark.parametrize("frames", [(14, 15), (0, 15), (20, None)])
def test_frames_that_are_not_there(frames: tuple[int, int | None], tmp_path: Path) -> None:
    source = write_slot_stream(tmp_path / "s", 14)
    with pytest.raises(InvalidError, match="has frames 0:14"):
        trim_stream(source, tmp_path / "t", FrameRange(*frames))
    assert not (tmp_path / "t").exists()


def test_a_wrong_object_is_named_and_nothing_is_left(tmp_path: Path) -> None:
    source = write_slot_stream(tmp_path / "s", 14)
    path = source / "segments" / "2" / "snapshot-1"
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    for frames in (FrameRange(0, 14), FrameRange(4, 14)):
        with pytest.raises(CorruptError, match="segments/2/snapshot-1"):
            trim_stream(source, tmp_path / "t", frames)
    assert [entry.name for entry in tmp_path.iterdir()] == ["s"]
