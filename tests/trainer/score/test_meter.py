"""The quality that a writer records is that of `swings-eval` on the files, for slots, too."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from codec.lattice.lattice import Lattice
from codec.slice import Slice
from codec.slots.slotlayout import SlotLayout
from codec.slots.update import Update
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import Manifest
from tests.support.slots.folder import slots_manifest
from tests.support.slots.updates import patternless_updates
from tests.support.tiny_capture import seen_by, write_dynamic3dgs
from tests.support.tiny_stream import tiny_manifest, tiny_slice
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
    """A capture with one held-out camera for all frames, and updates to write."""
    path = tmp_path / "capture"
    write_dynamic3dgs(path, num_cameras=3, num_frames=FRAMES)
    capture = open_capture(path)
    lattice = Lattice(0.01, 0.05, 1 / 60, 0.056, 161, -2.0)
    layout = SlotLayout(request.param, (20, 10), 0, (lattice,) * 2, SEGMENT)
    manifest = replace(seen_by(slots_manifest(layout), path), near_m=0.2)
    with ExitStack() as stack:
        cache = stack.enter_context(FrameCache(capture, range(FRAMES), 1.0, 1 << 24))
        yield Made(path, cache, manifest, patternless_updates(layout, FRAMES))


def write(made: Made, stream: Path, killed_at: int | None = None) -> list[list[float]]:
    """Writes the stream; returns the meter's scores of each frame. killed_at: the birth before
    which the writer is dropped and another one resumes."""
    meter = QualityMeter(made.cache, made.manifest)
    said: dict[int, list[float]] = {}

    def noted(frame: int, slices: Sequence[Slice]) -> list[float] | None:
        scores_db = meter(frame, slices)
        if scores_db is not None:
            said[frame] = scores_db
            assert meter.mean_db == scores_db[-1]  # of the only camera
        return scores_db

    writer = StreamWriter.create(stream, made.manifest, quality=noted)
    at = 0
    while at < len(made.updates):
        update = made.updates[at]
        if update.birth == killed_at:
            killed_at = None
            writer.abort()
            meter = QualityMeter(made.cache, made.manifest)
            writer = StreamWriter.resume(stream, quality=noted)
            meter.recall(StreamReader(stream), writer.next_birth)
            at = writer.next_birth - made.updates[0].birth
            continue
        writer.append(update)
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


def test_the_mean_is_over_all_held_out_cameras_from_the_first_frame_on(tmp_path: Path) -> None:
    """With very different cameras, the displayed quality must not jump from one to the other."""
    write_dynamic3dgs(tmp_path / "capture", num_cameras=6, num_frames=4)
    capture = open_capture(tmp_path / "capture")
    far = tuple(replace(c, held_out=i >= 3) for i, c in enumerate(capture.cameras))
    capture = replace(capture, cameras=far)
    manifest = replace(tiny_manifest(), near_m=0.2)
    with FrameCache(capture, range(4), 1.0, 1 << 24) as cache:
        meter = QualityMeter(cache, manifest)
        assert meter.mean_db is None
        means: list[float] = []
        by_turns: list[float] = []
        for birth in range(manifest.first_birth, 4):
            slice = tiny_slice(birth)
            scores_db = meter(birth, [slice] * manifest.num_layers)
            if birth >= 0:
                assert scores_db is not None
                assert meter.mean_db is not None
                by_turns.append(scores_db[-1])
                means.append(meter.mean_db)
    # The red of a picture grows with its camera, and the Gaussians hide little of it.
    assert max(by_turns) - min(by_turns) > 1
    assert max(means) - min(means) < 0.3
    assert means[0] == pytest.approx(np.mean(by_turns[:3]), abs=0.2)
