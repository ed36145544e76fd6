"""A stream gets a temporal layer, another one, or none, and shows the same frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codec.camera import Camera
from codec.edit.editing import edit_stream
from codec.edit.recolour import ColourOptions
from codec.errors import InvalidError
from codec.splats import Splats
from codec.stream import StreamReader
from codec.tools.audit import verify_stream
from codec.tools.cutting import set_temporal_layer
from tests.support.commands import run_ok
from tests.support.slots.edited import (
    NUM_FRAMES,
    frames_of,
    objects_bytes,
    segment_files,
    write_trained_like,
)
from tests.support.slots.slot_streams import gaussians, write_slot_stream
from tests.support.slots.updates import small_layout


def assert_same_frames(source: Path, other: Path) -> None:
    for before, after in zip(frames_of(source), frames_of(other), strict=True):
        assert gaussians(before) == gaussians(after)


@pytest.mark.parametrize("periods", [(2, 1), (4, 1), (4, 2), (1, 3), (8, 8)])
@pytest.mark.parametrize("seed", range(3))
def test_patternless_streams_moved(periods: tuple[int, int], seed: int, tmp_path: Path) -> None:
    before, after = periods
    layout = small_layout(1, (20, 10), 1, 8, before)
    source = write_slot_stream(tmp_path / "s", 21, layout, seed)
    made = set_temporal_layer(source, tmp_path / "t", after)
    assert (made.num_frames, verify_stream(tmp_path / "t").num_frames) == (21, 21)
    manifest = StreamReader(tmp_path / "t").manifest
    assert (manifest.temporal_period, manifest.segment_frames) == (after, 9 if after == 3 else 8)
    assert_same_frames(source, tmp_path / "t")


def test_without_it_the_stream_is_as_large_as_before(tmp_path: Path) -> None:
    source = write_trained_like(tmp_path / "s", 1)
    set_temporal_layer(source, tmp_path / "with", 2)
    set_temporal_layer(tmp_path / "with", tmp_path / "without", 1)
    assert_same_frames(source, tmp_path / "without")
    assert objects_bytes(tmp_path / "without") <= objects_bytes(source)
    assert objects_bytes(tmp_path / "with") > objects_bytes(source)


def test_an_edit_keeps_what_it_does_not_touch(tmp_path: Path) -> None:
    set_temporal_layer(write_trained_like(tmp_path / "s", 1), tmp_path / "with", 2)
    made = set_temporal_layer(tmp_path / "with", tmp_path / "again", 2)
    assert made.num_copied == made.num_segments
    assert segment_files(tmp_path / "again") == segment_files(tmp_path / "with")
    edit_stream(tmp_path / "with", tmp_path / "grey", ColourOptions(exposure=-1.0))
    assert StreamReader(tmp_path / "grey").manifest.temporal_period == 2
    for before, after in zip(frames_of(tmp_path / "s"), frames_of(tmp_path / "grey"), strict=True):
        np.testing.assert_array_equal(np.sort(after.means, axis=0), np.sort(before.means, axis=0))


def test_the_command_says_what_it_made(tmp_path: Path) -> None:
    write_trained_like(tmp_path / "my-stream", 1, 200)
    said = run_ok("swings-stream", "edit", "temporal", "my-stream", "my-halved", folder=tmp_path)
    assert f"my-halved: {NUM_FRAMES} frames in 3 segments" in said
    assert StreamReader(tmp_path / "my-halved").manifest.temporal_period == 2


def test_pictures_are_drawn_and_old_scores_do_not_stay(tmp_path: Path) -> None:
    source = write_trained_like(
        tmp_path / "s", 1, 200, quality=lambda frame, slices: [20.0] * len(slices)
    )

    def draw(splats: Splats, camera: Camera, near_m: float) -> np.ndarray:
        return np.zeros((camera.height_px, camera.width_px, 3), np.float32)

    set_temporal_layer(source, tmp_path / "t", 2, draw)
    reader = StreamReader(tmp_path / "t")
    assert reader.num_frames == NUM_FRAMES
    assert (tmp_path / "t" / "poster.jpg").is_file()
    assert all(np.isnan(record.psnr_db).all() for record in reader.records)


def test_lanes_have_no_temporal_layer(tmp_path: Path) -> None:
    source = write_slot_stream(tmp_path / "s", 9, small_layout(3, (6, 4), 0, 4))
    with pytest.raises(InvalidError, match="a swin_size of 1, not 3"):
        set_temporal_layer(source, tmp_path / "t", 2)
    with pytest.raises(InvalidError, match="temporal_period 9 is not in"):
        set_temporal_layer(write_trained_like(tmp_path / "l", 1), tmp_path / "t", 9)
    assert not (tmp_path / "t").exists()
