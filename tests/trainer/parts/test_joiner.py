"""Pieces of a stream, and the sound of the capture, are joined in order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.storage.openstorage import open_growing
from codec.stream import StreamReader
from codec.stream.index import record_bytes
from codec.stream.writer import SHAPE
from codec.tools.audit import verify_stream
from codec.tools.streamsound import add_sound
from tests.support.hosted_streams import write_stream
from tests.support.sounding import write_clicks
from tests.support.tiny_capture import write_dynamic3dgs
from trainer.capture.layout import open_capture
from trainer.parts.cut import cut
from trainer.parts.joiner import Joiner
from trainer.parts.part_state import MANIFEST_PATH, pack_arrays
from trainer.parts.task import Run, Task
from trainer.run.capturesound import SOURCE, CaptureSound, capture_sound
from trainer.run.config import TrainConfig

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


def test_a_run_in_parts_has_the_sound_that_is_added_to_the_stream(
    whole: Path, tmp_path: Path
) -> None:
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


@pytest.mark.parametrize("began_with", [True, False])
def test_a_run_goes_on_with_the_sound_that_it_began_with(
    whole: Path, tmp_path: Path, began_with: bool
) -> None:
    run = run_into(tmp_path / "joined")
    tasks = leave_pieces(whole, run)
    sounds = sound_of(tmp_path / "a.wav"), None
    now, other = sounds if began_with else sounds[::-1]
    joiner = Joiner(run, now)
    joiner.begin(resumed=False)
    next(joiner.go_on())
    resumed = Joiner(run, now)
    assert len(resumed.begin(resumed=True)) == len(tasks[0].frames) // SEGMENT_FRAMES
    with pytest.raises(InvalidError, match="sound, unlike the capture now"):
        Joiner(run, other).begin(resumed=True)
