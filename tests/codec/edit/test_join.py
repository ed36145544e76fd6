"""Joined streams, one after another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from codec.errors import InvalidError
from codec.files import write_atomic
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from codec.tools.audit import verify_stream
from codec.tools.cutting import join, trim_stream
from tests.support.slots.edited import (
    SEGMENT_FRAMES,
    frames_of,
    objects_bytes,
    segment_files,
    write_trained_like,
)
from tests.support.slots.slot_streams import gaussians, write_slot_stream
from tests.support.slots.updates import small_layout


@pytest.mark.parametrize(("swin_size", "period"), [(1, 1), (3, 1), (6, 1), (1, 2), (1, 4)])
@pytest.mark.parametrize("cuts", [(4,), (3,), (8, 12), (2, 5), (7, 9), (1, 12)])
def test_the_parts_joined(
    cuts: tuple[int, ...], swin_size: int, period: int, tmp_path: Path
) -> None:
    layout = small_layout(swin_size, (6, 4), 0, 4, period)
    source = write_slot_stream(tmp_path / "s", 14, layout, 5)
    edges = (0, *cuts, 14)
    parts = [tmp_path / str(n) for n in range(len(cuts) + 1)]
    for n, part in enumerate(parts):
        trim_stream(source, part, FrameRange(edges[n], edges[n + 1]))
    join(parts, tmp_path / "t")
    assert verify_stream(tmp_path / "t").num_frames == 14
    for frame, (before, after) in enumerate(
        zip(frames_of(source), frames_of(tmp_path / "t"), strict=True)
    ):
        assert gaussians(before) == gaussians(after), frame


@pytest.mark.parametrize("swin_size", [1, 5])
def test_what_was_cut_costs_no_more_once_joined(swin_size: int, tmp_path: Path) -> None:
    source = write_trained_like(tmp_path / "s", swin_size)
    parts = tmp_path / "a", tmp_path / "b"
    trim_stream(source, parts[0], FrameRange(0, SEGMENT_FRAMES))
    trim_stream(source, parts[1], FrameRange(SEGMENT_FRAMES))
    join(parts, tmp_path / "t")
    assert objects_bytes(tmp_path / "t") <= objects_bytes(source) * 1.01
    for before, after in zip(frames_of(source), frames_of(tmp_path / "t"), strict=True):
        assert gaussians(before) == gaussians(after)


@pytest.mark.parametrize("lengths", [(8, 14, 9), (7, 9, 12), (2, 3, 4), (4, 12, 4)])
@pytest.mark.parametrize("swin_size", [1, 3])
def test_other_streams_follow(swin_size: int, lengths: tuple[int, ...], tmp_path: Path) -> None:
    layout = small_layout(swin_size, (6, 4), 0, 4)
    parts = [
        write_slot_stream(tmp_path / str(n), length, layout, n) for n, length in enumerate(lengths)
    ]
    join(parts, tmp_path / "t")
    assert verify_stream(tmp_path / "t").num_frames == sum(lengths)
    found = list(frames_of(tmp_path / "t"))
    first = 0
    for n, part in enumerate(parts):
        for frame, wanted in enumerate(frames_of(part)):
            # A lane changes when its turn comes.
            if n == 0 or frame >= swin_size - 1:
                assert gaussians(found[first + frame]) == gaussians(wanted), (n, frame)
        first += lengths[n]


def test_whole_segments_are_copied(tmp_path: Path) -> None:
    layout = small_layout(2, (6, 4), 0, 4)
    parts = [write_slot_stream(tmp_path / str(n), 12, layout, n) for n in range(2)]
    made = join(parts, tmp_path / "t")
    # The first three are copied byte for byte, and the second stream's except its seam.
    assert (made.num_copied, made.num_renumbered, made.num_segments) == (3, 2, 6)
    files = segment_files(tmp_path / "t")
    assert segment_files(parts[0]).items() <= files.items()
    before, after = StreamReader(parts[1]), StreamReader(tmp_path / "t")
    for segment in (1, 2):
        for part in before.manifest.parts:
            old, new = before.read_object(segment, part), after.read_object(3 + segment, part)
            births = [entry.birth for entry in old.entries]
            assert [entry.birth for entry in new.entries] == [birth + 12 for birth in births]
            for birth in births:
                assert old.content(birth)[12:] == new.content(birth + 12)[12:]


def test_the_first_stream_gives_title_and_cameras_and_bounds_hold_both(tmp_path: Path) -> None:
    a = write_slot_stream(tmp_path / "a", 3, title="first", bounds=((0, 0, 0), (1, 1, 1)))
    b = write_slot_stream(tmp_path / "b", 3, title="other", bounds=((-1, 0, 0), (0.5, 2, 1)))
    join([a, b], tmp_path / "t")
    manifest = StreamReader(tmp_path / "t").manifest
    assert (manifest.title, manifest.bounds) == ("first", ((-1, 0, 0), (1, 2, 1)))


@pytest.mark.parametrize("changes", [{"fps": 12.0}, {"antialias": True}])
def test_streams_that_differ_are_refused(changes: dict[str, object], tmp_path: Path) -> None:
    a = write_slot_stream(tmp_path / "a", 3)
    b = write_slot_stream(tmp_path / "b", 3)
    manifest = Manifest.from_json((b / "manifest.json").read_bytes())
    write_atomic(b / "manifest.json", replace(manifest, **changes).to_json())  # type: ignore[arg-type]
    with pytest.raises(InvalidError, match=f"has another {next(iter(changes))} than"):
        join([a, b], tmp_path / "t")
    with pytest.raises(InvalidError, match="only one stream"):
        join([a], tmp_path / "t")
    assert not (tmp_path / "t").exists()
