"""A folder whose files arrive one after another, with a clock that the test sets."""

from __future__ import annotations

from pathlib import Path

import pytest

from codec.errors import InvalidError
from codec.interop.formats import SplatFormat, encode_splats, write_splats
from codec.sequence.incomingfiles import MAX_LOGGED, SETTLE_S, Arrival, Arrivals, Troubles
from tests.support.trained_like import trained_like_splats

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
    with pytest.raises(InvalidError, match="is not a folder"):
        Arrivals(tmp_path / "none", None, 1, 1.0, Troubles())
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


def test_a_missing_file_that_comes_in_time_is_not_missed(tmp_path: Path) -> None:
    rig = Rig(tmp_path, next_number=0)
    rig.write(1)
    assert rig.settled(after_s=0.8 * PATIENCE_S) is None
    rig.write(0)
    assert [rig.number(), rig.number()] == [0, 1]
    assert not rig.troubles.counts


def test_a_broken_file_is_stood_for(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig(tmp_path, next_number=0)
    rig.file(0).write_bytes(b"ply\nrubbish")
    assert rig.settled(after_s=100) is None
    rig.write(1)
    assert rig.settled() is None
    arrival = rig.poll(after_s=PATIENCE_S)
    assert arrival is not None
    assert (arrival.number, arrival.splats) == (0, None)
    assert "frame_0000.ply" in caplog.text
    assert rig.number() == 1
    assert rig.troubles.counts == {"odd files": 1}


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
