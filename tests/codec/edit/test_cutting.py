"""Streams cut and joined, bit by bit; and swings-stream edit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codec.edit.cut import join_streams, trim_stream
from codec.errors import CorruptError, InvalidError
from codec.files import write_atomic
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.manifest import SKIP_MAPS, Manifest
from codec.stream.views import view_from_text
from codec.tools.audit import verify_stream
from tests.support.commands import run, run_ok
from tests.support.hostile import refused
from tests.support.slots.edited import (
    NUM_FRAMES,
    SEGMENT_FRAMES,
    assert_same_frames,
    frames_of,
    objects_bytes,
    segment_files,
    write_trained_like,
)
from tests.support.slots.slot_streams import gaussians, write_slot_stream
from tests.support.slots.updates import small_layout

lanes = pytest.mark.parametrize("swin_size", [1, 3, 6])


@lanes
@pytest.mark.parametrize("frames", [(0, 4), (0, 14), (3, 4), (4, 14), (5, 11), (8, 11), (13, 14)])
def test_trimmed(frames: tuple[int, int], swin_size: int, tmp_path: Path) -> None:
    layout = small_layout(swin_size, (6, 4), 1, 4)
    source = write_slot_stream(tmp_path / "s", 14, layout, 3)
    trim_stream(source, tmp_path / "t", FrameRange(*frames))
    summary = verify_stream(tmp_path / "t")
    assert (summary.num_frames, summary.live) == (frames[1] - frames[0], False)
    assert StreamReader(tmp_path / "t").manifest.capture_frame == frames[0]
    wanted = list(frames_of(source))[slice(*frames)]
    for before, after in zip(wanted, frames_of(tmp_path / "t"), strict=True):
        assert gaussians(before) == gaussians(after)


def write_scored(path: Path) -> Path:
    return write_trained_like(path, 5, 200, quality=lambda frame, slices: [20.0 + frame] * 4)


def test_segments_that_keep_their_place_are_copied_byte_for_byte(tmp_path: Path) -> None:
    source = write_scored(tmp_path / "s")
    made = trim_stream(source, tmp_path / "t", FrameRange(0, 2 * SEGMENT_FRAMES))
    assert (made.num_copied, made.num_renumbered, made.num_segments) == (2, 0, 2)
    kept = {n: d for n, d in segment_files(source).items() if not n.startswith("segments/2/")}
    assert segment_files(tmp_path / "t") == kept
    assert StreamReader(tmp_path / "t").records == StreamReader(source).records[:2]


def test_segments_that_move_keep_their_chunks_but_for_the_frame_number(tmp_path: Path) -> None:
    source = write_scored(tmp_path / "s")
    made = trim_stream(source, tmp_path / "t", FrameRange(SEGMENT_FRAMES))
    assert (made.num_copied, made.num_renumbered, made.num_segments) == (0, 2, 2)
    before, after = StreamReader(source), StreamReader(tmp_path / "t")
    assert after.num_frames == NUM_FRAMES - SEGMENT_FRAMES
    for segment in (0, 1):
        assert after.records[segment].psnr_db == before.records[segment + 1].psnr_db
        for part in before.manifest.parts:
            old, new = before.read_object(segment + 1, part), after.read_object(segment, part)
            moved = {entry.birth - SEGMENT_FRAMES for entry in old.entries}
            if part == SKIP_MAPS or type(part) is int:
                moved -= {0}  # the content of that slice is in the keyframes
            assert {entry.birth for entry in new.entries} == moved
            for birth in moved:
                was, now = old.content(birth + SEGMENT_FRAMES), new.content(birth)
                assert (was[:8], was[12:]) == (now[:8], now[12:])
                assert int.from_bytes(now[8:12], "little") == birth
                assert len(new.packet(birth)) <= len(old.packet(birth + SEGMENT_FRAMES)) + 4


def test_a_wrong_object_is_named_and_nothing_is_left(tmp_path: Path) -> None:
    source = write_slot_stream(tmp_path / "s", 14)
    path = source / "segments" / "2" / "keyframe-1"
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    for frames in (FrameRange(0, 14), FrameRange(4, 14)):
        refused(CorruptError, "segments/2/keyframe-1", trim_stream, source, tmp_path / "t", frames)
    assert [entry.name for entry in tmp_path.iterdir()] == ["s"]


@lanes
@pytest.mark.parametrize("cuts", [(4,), (3,), (8, 12), (2, 5), (7, 9), (1, 12)])
def test_parts_joined(cuts: tuple[int, ...], swin_size: int, tmp_path: Path) -> None:
    layout = small_layout(swin_size, (6, 4), 0, 4)
    source = write_slot_stream(tmp_path / "s", 14, layout, 5)
    edges = (0, *cuts, 14)
    parts = [tmp_path / str(n) for n in range(len(cuts) + 1)]
    for n, part in enumerate(parts):
        trim_stream(source, part, FrameRange(edges[n], edges[n + 1]))
    join_streams(parts, tmp_path / "t")
    assert verify_stream(tmp_path / "t").num_frames == 14
    assert_same_frames(source, tmp_path / "t")


@pytest.mark.parametrize("lengths", [(8, 14, 9), (7, 9, 12), (2, 3, 4), (4, 12, 4)])
@pytest.mark.parametrize("swin_size", [1, 3])
def test_other_streams_follow(swin_size: int, lengths: tuple[int, ...], tmp_path: Path) -> None:
    layout = small_layout(swin_size, (6, 4), 0, 4)
    parts = [
        write_slot_stream(tmp_path / str(n), length, layout, n) for n, length in enumerate(lengths)
    ]
    join_streams(parts, tmp_path / "t")
    assert verify_stream(tmp_path / "t").num_frames == sum(lengths)
    found = list(frames_of(tmp_path / "t"))
    first = 0
    for n, part in enumerate(parts):
        for frame, wanted in enumerate(frames_of(part)):
            # A lane changes when its turn comes.
            if n == 0 or frame >= swin_size - 1:
                assert gaussians(found[first + frame]) == gaussians(wanted), (n, frame)
        first += lengths[n]
    whole = [f"segments/{n}/" for n in range(lengths[0] // layout.segment_frames)]
    kept = {k: d for k, d in segment_files(parts[0]).items() if k.startswith(tuple(whole))}
    assert kept.items() <= segment_files(tmp_path / "t").items()


def test_the_first_stream_gives_title_and_cameras_and_bounds_hold_both(tmp_path: Path) -> None:
    a = write_slot_stream(tmp_path / "a", 3, title="first", bounds=((0, 0, 0), (1, 1, 1)))
    b = write_slot_stream(tmp_path / "b", 3, title="other", bounds=((-1, 0, 0), (0.5, 2, 1)))
    join_streams([a, b], tmp_path / "t")
    manifest = StreamReader(tmp_path / "t").manifest
    assert (manifest.title, manifest.bounds) == ("first", ((-1, 0, 0), (1, 2, 1)))


@pytest.mark.parametrize("changes", [{"fps": 12.0}, {"antialias": True}])
def test_streams_that_differ_are_refused(changes: dict[str, object], tmp_path: Path) -> None:
    a = write_slot_stream(tmp_path / "a", 3)
    b = write_slot_stream(tmp_path / "b", 3)
    manifest = Manifest.from_json((b / "manifest.json").read_bytes())
    write_atomic(b / "manifest.json", replace(manifest, **changes).to_json())  # type: ignore[arg-type]
    refused(
        InvalidError,
        f"has another {next(iter(changes))} than",
        join_streams,
        [a, b],
        tmp_path / "t",
    )
    refused(InvalidError, "only one stream", join_streams, [a], tmp_path / "t")
    assert not (tmp_path / "t").exists()


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_trained_like(tmp_path_factory.mktemp("edit") / "s", 1, 200)


def test_one_edit_after_another(stream: Path, tmp_path: Path) -> None:
    def edit(kind: str, source: Path, out: str, *options: object) -> list[str]:
        return run_ok("swings-stream", "edit", kind, source, tmp_path / out, *options).splitlines()

    box = ["--box", -0.6, 0, -0.6, 0.6, 1.4, 0.6]
    told = edit("crop", stream, "crop", *box)
    size, whole = objects_bytes(tmp_path / "crop"), objects_bytes(stream)
    assert told == [
        f"{tmp_path / 'crop'}: {NUM_FRAMES} frames in 3 segments, 0 copied byte for byte",
        f"size         {size} bytes, {100 * size / whole:.1f} % of {whole}",
        "kept         {} of {} Gaussians in frame 0".format(
            *(len(next(iter(frames_of(path)))) for path in (tmp_path / "crop", stream))
        ),
    ]
    told = edit("transform", tmp_path / "crop", "moved", "--scale", 2, "--move", 1, 0, 0.5)
    assert told[2].startswith("moved        ")
    assert told[2].endswith(" m beside what was asked: whole steps")
    before, made = (StreamReader(path).manifest for path in (stream, tmp_path / "moved"))
    apart = made.camera().position - 2 * before.camera().position
    np.testing.assert_allclose(apart, (1, 0, 0.5), atol=2 * before.lattice[0].position_m)
    told = edit("trim", tmp_path / "moved", "part", "--frames", f"{SEGMENT_FRAMES}:")
    assert told[0].endswith("2 segments, 0 copied byte for byte, 2 with new frame numbers")
    told = edit("join", tmp_path / "moved", "both", "--then", tmp_path / "part")
    count = 2 * NUM_FRAMES - SEGMENT_FRAMES
    assert told[0].endswith(f": {count} frames in 4 segments, 2 copied byte for byte")
    assert verify_stream(tmp_path / "both").num_frames == count
    told = edit("view", tmp_path / "both", "seen", "--view=0.5,-0.1,0.8,0,0", "--title", "Seen")
    assert told[0].endswith(f": {count} frames in 4 segments, 4 copied byte for byte")
    edit("view", tmp_path / "seen", "again", "--camera", made.cameras[-1].name)
    seen, again = (StreamReader(tmp_path / name).manifest for name in ("seen", "again"))
    assert (seen.camera().w2c == view_from_text("0.5,-0.1,0.8,0,0", made).w2c).all()
    assert (seen.title, again.title, again.view) == ("Seen", "Seen", None)
    assert again.camera().name == made.cameras[-1].name
    for name, file in (("poster", "poster.jpg"), ("storyboard", "storyboard.webp")):
        assert getattr(StreamReader(tmp_path / "both").manifest, name) == file
        assert (tmp_path / "both" / file).is_file()


def test_what_goes_wrong_is_one_line_and_leaves_nothing(stream: Path, tmp_path: Path) -> None:
    before, out = segment_files(stream), tmp_path / "out"
    for arguments, word in (
        (["crop", stream, out], "give either --box or --sphere"),
        (["trim", stream, out, "--frames", "90:"], "has frames 0:14"),
        (["crop", stream, stream, "--sphere", 0, 0, 0, 1], "is not empty"),
        (["join", stream, out, "--then", tmp_path], "manifest.json"),
    ):
        done = run("swings-stream", "edit", *arguments)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
        assert word in done.stderr
    for misused in (["polish"], ["floaters", stream, out, "--cameras", 0], ["trim", stream, out]):
        assert run("swings-stream", "edit", *misused).returncode == 2
    assert list(tmp_path.iterdir()) == []
    assert segment_files(stream) == before
