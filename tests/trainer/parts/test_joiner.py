"""Pieces of a stream, and the capture's sound, are joined in order, with messages and records."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from codec.errors import InvalidError
from codec.progressline import ProgressLine
from codec.storage.openstorage import open_growing
from codec.stream import StreamReader
from codec.stream.segment import SegmentRecord, record_bytes
from codec.stream.writer import SHAPE
from codec.tools.audit import verify_stream
from codec.tracks.streamtracks import add_sound
from tests.support.hosted_streams import write_stream
from tests.support.sounding import write_clicks
from tests.support.tiny_capture import write_dynamic3dgs
from trainer.capture.layout import open_capture
from trainer.parts.joiner import Joiner, JoinMonitor
from trainer.parts.task import Run, Task, cut
from trainer.parts.worker import MANIFEST_PATH, pack_arrays
from trainer.run.config import TrainConfig
from trainer.run.monitor import RunLog
from trainer.run.outputs import SOURCE, CaptureSound, capture_sound

FPS = 10.0
FRAMES, PART_FRAMES, SEGMENT_FRAMES = 22, 7, 2


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """A stream written by one process."""
    made = write_stream(tmp_path / "whole", FRAMES, 20, fps=FPS, segment_frames=SEGMENT_FRAMES)
    write_clicks(tmp_path / "a.wav", 110_000, (500, 30_000, 105_000))
    return made


def run_into(stream: Path) -> Run:
    parts = cut(FRAMES, PART_FRAMES, SEGMENT_FRAMES, SEGMENT_FRAMES)
    return Run(TrainConfig("capture", str(stream)), tuple(parts))


def sound_of(file: Path) -> CaptureSound:
    write_dynamic3dgs(file.parent / "capture", num_cameras=4, num_frames=1)
    capture = open_capture(file.parent / "capture")
    config = TrainConfig("capture", "stream", audio=file)
    found = capture_sound(config, capture, range(FRAMES), lambda: FPS)
    assert found is not None
    return found


def leave_pieces(whole: Path, run: Run) -> list[Task]:
    """Writes the stream `whole` to the target of `run`, in pieces like those of its workers;
    returns their tasks."""
    files = open_growing(run.config.target, SHAPE)
    files.put(MANIFEST_PATH, (whole / "manifest.json").read_bytes())
    for path in (whole / "segments").rglob("*"):
        if path.is_file():
            files.put(str(path.relative_to(whole)), path.read_bytes())
    index = np.frombuffer((whole / "index.bin").read_bytes(), np.uint8)
    rows = index.reshape(-1, record_bytes(StreamReader(whole).manifest.num_layers))
    tasks = sorted(run.tasks[1:], key=lambda task: task.frames.start)
    for task in tasks:
        begin, end = task.frames.start // SEGMENT_FRAMES, -(-task.frames.stop // SEGMENT_FRAMES)
        files.put(task.last_path, pack_arrays({"records": rows[begin:end]}))
    return tasks


def test_a_run_in_parts_has_the_sound_that_is_added_later(whole: Path, tmp_path: Path) -> None:
    run = run_into(tmp_path / "joined")
    tasks = leave_pieces(whole, run)
    joiner = Joiner(run, sound_of(tmp_path / "a.wav"))
    assert joiner.begin(resumed=False) == []
    assert [task for task, _ in joiner.go_on()] == tasks
    assert joiner.finish().sound == (SOURCE,)
    verify_stream(tmp_path / "joined")
    add_sound(whole, tmp_path / "a.wav", SOURCE)
    for segment in range(FRAMES // SEGMENT_FRAMES):
        name = f"segments/{segment}/{SOURCE.part}"
        assert (tmp_path / "joined" / name).read_bytes() == (whole / name).read_bytes()


def test_a_run_goes_on_with_the_sound_that_it_began_with(whole: Path, tmp_path: Path) -> None:
    sound = sound_of(tmp_path / "a.wav")
    for now, other in ((sound, None), (None, sound)):
        run = run_into(tmp_path / f"joined {now is None}")
        tasks = leave_pieces(whole, run)
        joiner = Joiner(run, now)
        joiner.begin(resumed=False)
        next(joiner.go_on())
        resumed = Joiner(run, now)
        assert len(resumed.begin(resumed=True)) == len(tasks[0].frames) // SEGMENT_FRAMES
        with pytest.raises(InvalidError, match="sound, unlike the capture now"):
            Joiner(run, other).begin(resumed=True)


def record(segment: int, psnr_db: float, size: int) -> SegmentRecord:
    """A record whose skip maps and keyframe have no bytes."""
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


def test_a_resumed_run_says_what_is_known(tmp_path: Path) -> None:
    now_s = [0.0]
    for iterations, done, before, said in (
        # Iterations of an earlier run took none of the time.
        (1_000, 600, 500, "first of 60 frames  60% done  1:00 elapsed, 4:00 left"),
        (0, 0, 0, "first of 60 frames  0% done"),  # everything existed already
    ):
        told, path = io.StringIO(), tmp_path / "log"
        with ProgressLine(Console(file=told), lambda: now_s[0]) as line, RunLog(path) as log:
            monitor = JoinMonitor(line, log, 60, lambda: now_s[0])
            monitor.begin(iterations)
            now_s[0] += 60
            monitor.progressed(done, before=before)
        assert told.getvalue().startswith(said)
        assert not path.exists()
