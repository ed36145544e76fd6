"""Live streams of sequences that are still being written, with a clock that the test sets."""

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
from codec.interop.formats import SplatFormat, encode_splats, write_splats
from codec.sequence.following import Followed, FollowOptions, follow_folder
from codec.sequence.importing import ImportOptions
from codec.sequence.incomingfiles import MAX_LOGGED, SETTLE_S, Arrival, Arrivals, Troubles
from codec.splats import Splats
from codec.stream.reader import StreamReader
from player.render.cpu import render_splats
from tests.support.commands import run, started
from tests.support.hostile import refused
from tests.support.slots.rotating import figure, turned
from tests.support.trained_like import trained_like_splats
from tests.support.waiting import BOUND_S, wait_until

FPS = 10.0
OPTIONS = ImportOptions(fps=FPS)
QUICK = FollowOptions(end_after_s=0.2, patience_s=0.1)


def frame_of(number: int, count: int = 150) -> Splats:
    return turned(figure(count), 0.02 * number)


def write_frame(folder: Path, number: int, splats: Splats | None = None) -> None:
    folder.mkdir(exist_ok=True)
    write_splats(folder / f"f{number:03d}.ply", splats or frame_of(number), SplatFormat.PLY)


def write_frames(folder: Path, *numbers: int) -> None:
    for number in numbers:
        write_frame(folder, number)


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


def test_the_frame_before_stands_for_what_is_missing_or_broken(tmp_path: Path) -> None:
    folder, stream = tmp_path / "files", tmp_path / "stream"
    write_frames(folder, 5, 6, 9, 10)
    (folder / "f007.ply").write_bytes(b"ply\nrubbish")
    made = followed(folder, stream, draw=render_splats)
    assert made.num_frames == 6
    assert made.manifest.focus is not None
    assert made.troubles == "1 odd files, 1 missing files"
    manifest = StreamReader(stream).manifest
    assert (manifest.live, manifest.segment_frames, manifest.capture_frame) == (False, 2, 5)
    for frame, number in enumerate((5, 6, 6, 6, 9, 10)):
        assert_shows(stream, frame, frame_of(number))


def test_a_sequence_that_goes_on_elsewhere_is_refused_and_can_be_resumed(tmp_path: Path) -> None:
    folder, stream = tmp_path / "files", tmp_path / "stream"
    write_frames(folder, 0, 1, 2, 5000)
    refused(InvalidError, "frames 3 to 4999 are missing", followed, folder, stream)
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
    write_frames(folder, *range(8))

    def interrupted(done: int, total: int | None, what: str | None = None) -> None:
        if done == 5:
            raise KeyboardInterrupt

    refused(KeyboardInterrupt, "", followed, folder, stream, progress=interrupted)
    reader = StreamReader(stream)
    assert reader.manifest.live
    assert reader.num_frames == 4
    refused(InvalidError, "is not empty", followed, folder, stream)
    before = (stream / "segments" / "0" / "0").read_bytes()
    made = followed(folder, stream, resume=True)
    assert made.num_frames == 8
    assert (stream / "segments" / "0" / "0").read_bytes() == before
    for frame in range(8):
        assert_shows(stream, frame, frame_of(frame))
    # Gaussians that go on are predicted, not sent again.
    changes = [(stream / "segments" / str(n) / "0").stat().st_size for n in (0, 1)]
    assert changes[1] < 3 * changes[0]
    refused(InvalidError, "is finished", followed, folder, stream, resume=True)


def test_options_that_do_not_go_together(tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    for options in (
        replace(OPTIONS, exact=True),
        replace(OPTIONS, frames=FrameRange(1)),
        ImportOptions(),  # no rate
    ):
        refused(InvalidError, "", followed, tmp_path / "files", tmp_path / "stream", options)
    for wrong in ({"room": 0.5}, {"step": 0}, {"segment_s": 0.0}, {"end_after_s": float("nan")}):
        refused(InvalidError, "", FollowOptions, **wrong)
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
        wait_until(lambda: StreamReader(stream).num_frames == 4)
        assert StreamReader(stream).manifest.live
    finally:
        process.send_signal(number)
        _, said = process.communicate(timeout=BOUND_S)
    finishes = number == signal.SIGINT
    assert process.returncode == (0 if finishes else 128 + number), said
    reader = StreamReader(stream)
    assert reader.manifest.live is not finishes
    assert reader.num_frames == 4
    assert finishes or "--resume" in said


PATIENCE_S = 1.0


class Rig:
    """A folder, its follower, and their clock."""

    def __init__(self, folder: Path, next_number: int | None = None, step: int = 1) -> None:
        self.folder, self.time_s, self.troubles = folder, 100.0, Troubles()
        folder.mkdir(exist_ok=True)
        self.arrivals = Arrivals(
            folder, next_number, step, PATIENCE_S, self.troubles, lambda: self.time_s
        )

    def file(self, number: int, suffix: str = "ply") -> Path:
        return self.folder / f"frame_{number:04d}.{suffix}"

    def write(self, number: int, count: int = 5) -> None:
        write_splats(self.file(number), trained_like_splats(count, number), SplatFormat.PLY)

    def poll(self, after_s: float = 0.0) -> Arrival | None:
        self.time_s += after_s
        return self.arrivals.poll()

    def settled(self, after_s: float = 0.0) -> Arrival | None:
        """The next arrival once the files no longer change."""
        return self.poll(after_s) or self.poll(2 * SETTLE_S)

    def number(self, after_s: float = 0.0) -> int | None:
        arrival = self.settled(after_s)
        return None if arrival is None or arrival.splats is None else arrival.number


def test_frames_come_in_order_of_number_and_begin_anywhere(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    assert rig.settled() is None
    for number in (10, 9, 11):
        rig.write(number)
    assert [rig.number(), rig.number(), rig.number(), rig.number()] == [9, 10, 11, None]
    refused(InvalidError, "is not a folder", Arrivals, tmp_path / "none", None, 1, 1.0, Troubles())
    rig.write(12)
    assert rig.number() == 12
    assert not rig.troubles.counts


def test_a_file_counts_only_once_it_is_whole(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    splats = trained_like_splats(50)
    data = encode_splats(splats, SplatFormat.PLY)
    for share in (0.0, 0.1, 0.5, 0.99):
        rig.file(0).write_bytes(data[: int(share * len(data))])
        assert rig.number(after_s=10) is None
    # Its place may be reserved.
    header = data.index(b"end_header\n") + len(b"end_header\n")
    rig.file(0).write_bytes(data[:header] + bytes(len(data) - header))
    assert rig.number(after_s=1) is None
    rig.file(0).write_bytes(data)
    arrival = rig.settled()
    assert arrival is not None
    assert arrival.splats is not None
    assert len(arrival.splats) == 50
    assert not rig.troubles.counts


def test_a_gap_is_given_up_only_when_a_later_file_has_been_there(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.write(0)
    assert rig.number() == 0
    assert rig.settled(after_s=100) is None  # the writer may be slow
    rig.write(3)
    assert rig.settled() is None
    rig.time_s += PATIENCE_S
    held = [rig.settled(), rig.settled()]
    assert [one and (one.number, one.splats) for one in held] == [(1, None), (2, None)]
    assert rig.number() == 3
    rig.write(1)
    assert rig.settled() is None
    assert rig.troubles.counts == {"missing files": 2, "late files": 1}
    # Whoever resumes knows that the earlier files are in the stream.
    resumed = Rig(tmp_path, next_number=3)
    assert resumed.number() == 3
    resumed.write(2)
    assert resumed.number() is None
    assert resumed.troubles.counts == {"late files": 1}


def test_a_folder_that_is_away_is_waited_for(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rig = Rig(tmp_path / "share")
    rig.write(0)
    assert rig.number() == 0
    for number in (1, 3):
        rig.write(number)
    rig.folder.rename(tmp_path / "away")
    assert rig.number(after_s=3 * PATIENCE_S) is None
    assert rig.number() is None
    (tmp_path / "away").rename(rig.folder)
    assert rig.number() == 1
    assert rig.troubles.counts == {"absences of the folder": 1}
    assert "share is away: No such file or directory; waiting for it" in caplog.text


def test_a_file_that_goes_on_after_it_was_taken_is_named(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    data = encode_splats(trained_like_splats(20), SplatFormat.SPLAT)
    rig.file(0, "splat").write_bytes(data[: 10 * 32])
    assert rig.number() is None
    assert rig.number(after_s=1.0) == 0
    rig.file(0, "splat").write_bytes(data)
    rig.write(1)
    assert rig.number() == 1
    rig.file(1).unlink()
    for _ in range(3):
        assert rig.number() is None
    assert rig.troubles.counts == {"changed files": 1}


def test_what_is_no_frame_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig(tmp_path, next_number=0, step=2)
    (tmp_path / "final.ply").write_bytes(b"ply")
    (tmp_path / "notes.txt").write_text("nothing")
    (tmp_path / ".frame_0000.ply").write_bytes(b"ply")
    (tmp_path / "pipe_4.ply").mkdir()
    rig.write(1)
    rig.write(0)
    (tmp_path / "other_0000.ply").write_bytes(b"ply")
    assert rig.number() == 0
    assert rig.troubles.counts == {"odd names": 4}
    for name in ("final.ply", "pipe_4.ply", "frame_0001.ply", "other_0000.ply"):
        assert name in caplog.text
    assert "notes.txt" not in caplog.text


def test_trouble_that_goes_on_does_not_fill_the_log(caplog: pytest.LogCaptureFixture) -> None:
    troubles = Troubles()
    for number in range(1000):
        troubles.note("late files", f"file {number}")
    assert len(caplog.records) == MAX_LOGGED
    assert "only counted" in caplog.records[-1].message
    assert str(troubles) == "1000 late files"
