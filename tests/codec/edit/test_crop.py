"""A cropped stream shows the same Gaussians as cropped frames, one for one."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from codec.edit.crop import CropOptions
from codec.edit.editing import edit_stream
from codec.errors import SwingsError
from codec.pose import Doubles
from codec.slots.slotstate import Rows
from codec.stream import StreamReader
from codec.tools.audit import verify_stream
from codec.tools.static import export_static
from tests.support.slots.edited import (
    NUM_FRAMES,
    assert_same_frames,
    frames_of,
    objects_bytes,
    segment_files,
    write_trained_like,
)
from tests.support.slots.slot_streams import gaussians, write_slot_stream
from tests.support.slots.updates import small_layout

BOX = (-0.5, 0.2, -0.5, 0.6, 1.3, 0.5)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_trained_like(tmp_path_factory.mktemp("crop") / "s", 1)


def in_box(means: Doubles, box: tuple[float, ...] = BOX) -> Rows:
    inside: Rows = np.flatnonzero(((means >= box[:3]) & (means <= box[3:])).all(axis=1))
    return inside


@pytest.mark.parametrize("swin_size", [1, 5])
def test_a_box_and_its_complement_share_the_gaussians(swin_size: int, tmp_path: Path) -> None:
    source = write_trained_like(tmp_path / "s", swin_size)
    edit_stream(source, tmp_path / "in", CropOptions(box=BOX))
    edit_stream(source, tmp_path / "out", CropOptions(box=BOX, outside=True))
    for name in ("in", "out"):
        verify_stream(tmp_path / name)
        assert objects_bytes(tmp_path / name) < objects_bytes(source)
    frames = [frames_of(path) for path in (source, tmp_path / "in", tmp_path / "out")]
    for whole, inside, outside in zip(*frames, strict=True):
        wanted = whole.take(in_box(whole.means.astype(np.float64)))
        assert len(wanted)
        assert gaussians(inside) == gaussians(wanted)
        assert gaussians(inside) + gaussians(outside) == gaussians(whole)


@pytest.mark.parametrize(("swin_size", "period"), [(1, 1), (2, 1), (3, 1), (1, 2), (1, 4)])
def test_patternless_streams_cropped(swin_size: int, period: int, tmp_path: Path) -> None:
    layout = small_layout(swin_size, (20, 10), 1, 4, period)
    source = write_slot_stream(tmp_path / "s", 14, layout, 1)
    box = (-2.0, -2.0, -50.0, 1.5, 2.0, 3.0)
    edit_stream(source, tmp_path / "t", CropOptions(box=box))
    verify_stream(tmp_path / "t")
    for whole, found in zip(frames_of(source), frames_of(tmp_path / "t"), strict=True):
        wanted = whole.take(in_box(whole.means.astype(np.float64), box))
        assert gaussians(found) == gaussians(wanted)


def test_a_region_that_changes_over_time(source: Path, tmp_path: Path) -> None:
    keyframes = tmp_path / "ball.json"
    keyframes.write_text(
        json.dumps([{"frame": 2, "sphere": [0, 0, 0, 1]}, {"frame": 12, "sphere": [0, 1, 0.5, 2]}])
    )
    edit_stream(source, tmp_path / "t", CropOptions(keyframes=keyframes))
    verify_stream(tmp_path / "t")
    counts = []
    pairs = zip(frames_of(source), frames_of(tmp_path / "t"), strict=True)
    for frame, (whole, found) in enumerate(pairs):
        share = np.clip((frame - 2) / 10, 0, 1)
        apart = whole.means.astype(np.float64) - np.array([0, share, 0.5 * share])
        wanted = np.flatnonzero((apart**2).sum(axis=1) <= (1 + share) ** 2)
        assert gaussians(found) == gaussians(whole.take(wanted))
        counts.append(len(found))
    assert max(counts) > 1.2 * min(counts)


def test_what_is_untouched_keeps_its_bytes_and_its_psnr(tmp_path: Path) -> None:
    score = [20.0, 21, 22, 23]
    source = write_trained_like(tmp_path / "s", 1, quality=lambda frame, slices: score)
    everything = CropOptions(sphere=(0, 0, 0, 1e4))
    made = edit_stream(source, tmp_path / "t", everything)
    assert segment_files(tmp_path / "t") == segment_files(source)
    assert (made.num_copied, made.num_segments) == (3, 3)
    before, after = StreamReader(source), StreamReader(tmp_path / "t")
    assert after.records == before.records
    assert after.manifest.bounds == before.manifest.bounds
    # A removed Gaussian changes every segment, so that no PSNR is known.
    edit_stream(source, tmp_path / "u", CropOptions(box=BOX))
    assert all(math.isnan(record.psnr_db[0]) for record in StreamReader(tmp_path / "u").records)


def test_a_static_export_stays_one_that_browsers_inflate(source: Path, tmp_path: Path) -> None:
    export_static(source, tmp_path / "static")
    edit_stream(tmp_path / "static", tmp_path / "t", CropOptions(box=BOX))
    verify_stream(tmp_path / "t")
    edit_stream(source, tmp_path / "u", CropOptions(box=BOX))
    assert_same_frames(tmp_path / "t", tmp_path / "u")
    assert {data[13] for data in segment_files(tmp_path / "t").values()} == {2}
    assert objects_bytes(tmp_path / "t") < objects_bytes(tmp_path / "static")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (CropOptions(), "exactly one"),
        (CropOptions(box=BOX, sphere=(0, 0, 0, 1)), "exactly one"),
        (CropOptions(box=(0, 0, 0, 1, -1, 1)), "must lie below"),
        (CropOptions(box=(0, 0, 0, 1, math.nan, 1)), "must lie below"),
        (CropOptions(sphere=(0, 0, 0, 0)), "radius"),
        (CropOptions(keyframes=Path("missing.json")), "missing.json is missing"),
    ],
)
def test_what_is_no_region_is_refused(
    options: CropOptions, message: str, source: Path, tmp_path: Path
) -> None:
    with pytest.raises(SwingsError, match=message):
        edit_stream(source, tmp_path / "t", options)
    assert not (tmp_path / "t").exists()


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        "[1]",
        '[{"frame": 0}]',
        '[{"frame": 0.5, "box": [0, 0, 0, 1, 1, 1]}]',
        '[{"frame": 0, "box": [0, 0, 0, 1, 1]}]',
        '[{"frame": 0, "box": [0, 0, 0, 1, 1, "x"]}]',
        '[{"frame": 0, "box": [0, 0, 0, 1, 1, NaN]}]',
        '[{"frame": 3, "box": [0, 0, 0, 1, 1, 1]}, {"frame": 3, "box": [0, 0, 0, 1, 1, 1]}]',
        '[{"frame": 3, "box": [0, 0, 0, 1, 1, 1]}, {"frame": 4, "sphere": [0, 0, 0, 1]}]',
        "[" * 100_000,
        '[{"frame": 0, "sphere": [0, 0, 0, 1' + "0" * 400 + "]}]",
    ],
)
def test_keyframes_that_break_a_rule_are_named(text: str, source: Path, tmp_path: Path) -> None:
    (tmp_path / "k.json").write_text(text)
    with pytest.raises(SwingsError, match=r"k\.json"):
        edit_stream(source, tmp_path / "t", CropOptions(keyframes=tmp_path / "k.json"))
    assert not (tmp_path / "t").exists()


def test_an_edit_that_is_interrupted_leaves_nothing(source: Path, tmp_path: Path) -> None:

    def interrupt(done: int, total: int) -> None:
        assert total == NUM_FRAMES
        if done == 10:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        edit_stream(source, tmp_path / "t", CropOptions(box=BOX), progress=interrupt)
    assert not list(tmp_path.iterdir())
