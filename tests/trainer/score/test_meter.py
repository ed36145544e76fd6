"""The quality that a writer notes is what `swings-eval` finds in the files, for slots, too."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from codec.slots.lattice import Lattice
from codec.slots.slotlayout import SlotLayout
from codec.slots.update import Update
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import Manifest
from tests.support.slots.folder import slots_manifest
from tests.support.slots.updates import patternless_updates
from tests.support.tiny_capture import write_dynamic3dgs
from trainer.capture.layout import open_capture
from trainer.pictures.framecache import FrameCache
from trainer.score.evaluate import EvaluateConfig, evaluate_stream
from trainer.score.meter import QualityMeter

FRAMES, SEGMENT = 8, 3


@dataclass(frozen=True)
class Made:
    capture: Path
    cache: FrameCache
    manifest: Manifest
    updates: list[Update]


@pytest.fixture(params=[1, 3])
def made(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Made]:
    """A capture whose one held-out camera sees all frames, and updates to write."""
    path = tmp_path / "capture"
    write_dynamic3dgs(path, num_cameras=3, num_frames=FRAMES)
    capture = open_capture(path)
    cameras = tuple(c.camera for c in capture.cameras)
    lattice = Lattice(0.01, 0.05, 1 / 60, 0.056, 161, -2.0)
    layout = SlotLayout(request.param, (20, 10), 0, (lattice,) * 2, SEGMENT)
    manifest = replace(
        slots_manifest(layout), cameras=cameras, default_camera=cameras[0].name, near_m=0.2
    )
    with ExitStack() as stack:
        cache = stack.enter_context(FrameCache(capture, range(FRAMES), 1.0, 1 << 24))
        yield Made(path, cache, manifest, patternless_updates(layout, FRAMES))


def write(made: Made, stream: Path, killed_at: int | None = None) -> list[list[float]]:
    """Writes the stream; what the meter said of each frame. killed_at: the birth before which the
    writer is dropped, and another one resumes."""
    meter = QualityMeter(made.cache, made.manifest)
    writer = StreamWriter.create(stream, made.manifest, quality=meter)
    said: dict[int, list[float]] = {}
    at = 0
    while at < len(made.updates):
        update = made.updates[at]
        if update.birth == killed_at:
            killed_at = None
            writer.abort()
            meter = QualityMeter(made.cache, made.manifest)
            writer = StreamWriter.resume(stream, quality=meter)
            meter.recall(StreamReader(stream), writer.next_birth)
            at = writer.next_birth - made.updates[0].birth
            continue
        writer.append(update)
        if update.birth >= 0:
            said[update.birth] = list(meter.last_db)
        at += 1
    writer.close()
    return [said[frame] for frame in range(FRAMES)]


@pytest.mark.parametrize("killed_at", [None, 4, 7])
def test_a_frame_is_scored_as_a_reader_shows_it(
    killed_at: int | None, made: Made, tmp_path: Path
) -> None:
    stream = tmp_path / "stream"
    said = write(made, stream, killed_at)
    scores = evaluate_stream(EvaluateConfig(stream, made.capture)).layers
    expected = np.transpose([score.per_frame_psnr_db for score in scores])
    assert np.array(said) == pytest.approx(expected, abs=1e-4)
    assert len({round(db, 6) for frame in said for db in frame}) > FRAMES  # they differ
    for record in StreamReader(stream).records:
        frames = range(record.first_frame, record.first_frame + record.num_frames)
        assert record.psnr_db == pytest.approx(expected[frames].mean(axis=0), abs=1e-4)
