"""Live streams of sequences that are still being written."""

from __future__ import annotations

import itertools
import signal
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.interop.formats import SplatFormat, write_splats
from codec.sequence.following import Followed, FollowOptions, follow_folder
from codec.sequence.importing import ImportOptions
from codec.splats import Splats
from codec.stream.reader import StreamReader
from tests.support.commands import run, started
from tests.support.slots.rotating import figure, turned
from tests.support.waiting import BOUND_S, wait_until

FPS = 10.0
OPTIONS = ImportOptions(fps=FPS)
QUICK = FollowOptions(end_after_s=0.2, patience_s=0.1)


def frame_of(number: int, count: int = 150) -> Splats:
    return turned(figure(count), 0.02 * number)


def write_frame(folder: Path, number: int, splats: Splats | None = None) -> None:
    folder.mkdir(exist_ok=True)
    write_splats(folder / f"f{number:03d}.ply", splats or frame_of(number), SplatFormat.PLY)


class Unwaiting(threading.Event):
    """An event that is never set and that nobody waits for: time is an argument."""

    def wait(self, timeout: float | None = None) -> bool:
        return False


def followed(folder: Path, stream: Path, options: ImportOptions = OPTIONS, **more: Any) -> Followed:
    """Follows `folder` on a clock that goes on by 10 ms at every look."""
    clock = itertools.count(0.0, 0.01)
    resume = more.pop("resume", False)
    return follow_folder(
        folder, stream, options, QUICK, resume, Unwaiting(), now_s=clock.__next__, **more
    )


def shown(stream: Path, frame: int) -> Splats:
    reader = StreamReader(stream)
    return reader.active_splats(frame, reader.manifest.num_layers)


def assert_shows(stream: Path, frame: int, wanted: Splats) -> None:
    """Asserts that `frame` has the Gaussians of `wanted`, within the default errors."""
    found = shown(stream, frame)
    assert len(found) == len(wanted)
    bound_m = 2 * StreamReader(stream).manifest.lattice[0].position_m
    apart_m = abs(found.means[:, None] - wanted.means[None]).max(axis=2)
    assert apart_m.min(axis=1).max() <= bound_m
    assert apart_m.min(axis=0).max() <= bound_m


def test_every_file_is_a_frame(tmp_path: Path) -> None:
    folder, stream = tmp_path / "files", tmp_path / "stream"
    for number in range(5, 12):
        write_frame(folder, number)
    made = followed(folder, stream)
    assert (made.num_frames, made.troubles) == (7, "")
    manifest = StreamReader(stream).manifest
    assert not manifest.live
    assert manifest.segment_frames == round(0.2 * FPS)
    assert manifest.capture_frame == 5
    for frame in range(7):
        assert_shows(stream, frame, frame_of(5 + frame))


def test_the_frame_before_stands_for_what_is_missing_or_broken(tmp_path: Path) -> None:
    folder, stream = tmp_path / "files", tmp_path / "stream"
    for number in (0, 1, 4, 5):
        write_frame(folder, number)
    (folder / "f002.ply").write_bytes(b"ply\nrubbish")
    made = followed(folder, stream)
    assert made.num_frames == 6
    assert made.troubles == "1 odd files, 1 missing files"
    for frame, number in enumerate((0, 1, 1, 1, 4, 5)):
        assert_shows(stream, frame, frame_of(number))


def test_a_sequence_that_goes_on_elsewhere_is_refused_and_can_be_resumed(tmp_path: Path) -> None:
    folder, stream = tmp_path / "files", tmp_path / "stream"
    for number in (0, 1, 2, 5000):
        write_frame(folder, number)
    with pytest.raises(InvalidError, match="frames 3 to 4999 are missing"):
        followed(folder, stream)
    assert StreamReader(stream).manifest.live
    (folder / "f5000.ply").rename(folder / "f003.ply")
    assert followed(folder, stream, resume=True).num_frames == 4


def test_a_fuller_file_loses_the_least(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder, stream = tmp_path / "files", tmp_path / "stream"
    write_frame(folder, 0, frame_of(0, 100))
    fuller = frame_of(1, 200)
    write_frame(folder, 1, fuller)
    made = followed(folder, stream)
    assert made.troubles == "1 files over the room"
    assert "room for 125" in caplog.text
    kept = shown(stream, 1)
    assert len(kept) == 125
    paint = np.sort(fuller.opacities)[::-1]
    assert kept.opacities.mean() > paint.mean()


def test_files_of_another_degree_are_fitted(tmp_path: Path) -> None:
    folder, stream = tmp_path / "files", tmp_path / "stream"
    write_frame(folder, 0, frame_of(0).with_degree(1))
    write_frame(folder, 1)
    write_frame(folder, 2, frame_of(2).with_degree(3))
    made = followed(folder, stream)
    assert made.num_frames == 3
    assert made.troubles == "2 files of another SH degree"
    assert shown(stream, 2).sh_degree == 1


def test_resumed_it_goes_on_after_its_last_segment(tmp_path: Path) -> None:
    folder, stream = tmp_path / "files", tmp_path / "stream"
    for number in range(8):
        write_frame(folder, number)

    def interrupted(done: int, total: int | None, what: str | None = None) -> None:
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        followed(folder, stream, progress=interrupted)
    reader = StreamReader(stream)
    assert reader.manifest.live
    assert reader.num_frames == 4
    with pytest.raises(InvalidError, match="is not empty"):
        followed(folder, stream)
    before = (stream / "segments" / "0" / "0").read_bytes()
    made = followed(folder, stream, resume=True)
    assert made.num_frames == 8
    assert (stream / "segments" / "0" / "0").read_bytes() == before
    for frame in range(8):
        assert_shows(stream, frame, frame_of(frame))
    # Gaussians that go on are predicted, not sent again.
    changes = [(stream / "segments" / str(n) / "0").stat().st_size for n in (0, 1)]
    assert changes[1] < 3 * changes[0]
    with pytest.raises(InvalidError, match="is finished"):
        followed(folder, stream, resume=True)


def test_options_that_do_not_go_together(tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    for options in (
        replace(OPTIONS, exact=True),
        replace(OPTIONS, frames=FrameRange(1)),
        ImportOptions(),  # no rate
    ):
        with pytest.raises(InvalidError):
            followed(tmp_path / "files", tmp_path / "stream", options)
    for wrong in ({"room": 0.5}, {"step": 0}, {"segment_s": 0.0}, {"end_after_s": float("nan")}):
        with pytest.raises(InvalidError):
            FollowOptions(**wrong)
    said = run("swings-stream", "import", "a", "b", "--resume")
    assert (said.returncode, "need --follow" in said.stderr) == (2, True)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_finishes_and_others_leave_it_live(tmp_path: Path, number: signal.Signals) -> None:
    folder, stream = tmp_path / "files", tmp_path / "stream"
    folder.mkdir()
    process = started("swings-stream", "import", folder, stream, "--follow", "--fps", "10")
    try:
        for frame in range(4):
            write_frame(folder, frame, frame_of(frame, 40))
        wait_until((stream / "segments" / "0").exists)
        wait_until(lambda: StreamReader(stream).num_frames >= 2)
        assert StreamReader(stream).manifest.live
    finally:
        process.send_signal(number)
        _, said = process.communicate(timeout=BOUND_S)
    finishes = number == signal.SIGINT
    assert process.returncode == (0 if finishes else 128 + number), said
    reader = StreamReader(stream)
    assert reader.manifest.live is not finishes
    assert reader.num_frames >= 2
    assert finishes or "--resume" in said
