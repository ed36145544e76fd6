"""Messages and records while parts are joined."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path

from rich.console import Console

from codec.progressline import ProgressLine
from codec.stream.index import SegmentRecord
from trainer.parts.joinmonitor import JoinMonitor
from trainer.run.runlog import RunLog


def record(segment: int, psnr_db: float, size: int) -> SegmentRecord:
    """A record whose masks and snapshot have no bytes."""
    hashes = (bytes(32),) * 2
    return SegmentRecord(segment, 10 * segment, 10, (size,), hashes[:1], (psnr_db,), (0, 0), hashes)


def test_the_log_has_a_line_for_each_segment_and_means_over_all(tmp_path: Path) -> None:
    now_s, told = 100.0, io.StringIO()
    path = tmp_path / "log.jsonl"
    with ProgressLine(Console(file=told), lambda: now_s) as line, RunLog(path) as log:
        monitor = JoinMonitor(line, log, 60, lambda: now_s)
        monitor.begin(1_000)
        monitor.found([record(0, 20.0, 500)])
        now_s += 60
        monitor.progressed(250)
        monitor.joined([record(1, 30.0, 300), record(2, math.nan, 100)])
        now_s += 60
        monitor.progressed(2_000)  # more than expected does not exceed 100 %
        monitor.joined([record(3, 40.0, 100)])
    rows = [json.loads(row) for row in path.read_text().splitlines()]
    assert [row["frame"] for row in rows] == [19, 29, 39]
    assert [row["psnr_db"] for row in rows] == [25, 25, 30]
    assert [row["bytes_per_frame"] for row in rows] == [40, 30, 25]
    assert [(row["time_s"], row["left_s"]) for row in rows[:2]] == [(60, 180)] * 2
    lines = told.getvalue().splitlines()
    assert lines[0].startswith("frame 10 of 60  25% done  1:00 elapsed, 3:00 left  20.00 dB")
    assert lines[-1].startswith("frame 40 of 60  100% done  2:00 elapsed")


def test_iterations_of_an_earlier_run_took_none_of_the_time(tmp_path: Path) -> None:
    now_s, told = 0.0, io.StringIO()
    with ProgressLine(Console(file=told), lambda: now_s) as line, RunLog(tmp_path / "log") as log:
        monitor = JoinMonitor(line, log, 60, lambda: now_s)
        monitor.begin(1_000)
        now_s += 60
        monitor.progressed(600, before=500)
    assert told.getvalue().startswith("first of 60 frames  60% done  1:00 elapsed, 4:00 left")


def test_nothing_is_said_of_what_is_not_known(tmp_path: Path) -> None:
    told = io.StringIO()
    with ProgressLine(Console(file=told)) as line, RunLog(tmp_path / "log") as log:
        monitor = JoinMonitor(line, log, 60)
        monitor.begin(0)  # everything existed already
        monitor.progressed(0)
    assert told.getvalue().startswith("first of 60 frames  0% done")
    assert not (tmp_path / "log").exists()
