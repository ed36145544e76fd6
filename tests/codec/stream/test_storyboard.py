"""The storyboard: a bounded number of small pictures, each of the frame for its place."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from codec.camera import Camera
from codec.errors import CorruptError, InvalidError
from codec.splats import Splats
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from codec.stream.pictures import MAX_PICTURE_BYTES, check_pictures
from codec.stream.storyboard import (
    AIM_BYTES,
    MAX_TILES,
    STORYBOARD_NAME,
    StoryboardLayout,
    write_storyboard,
)
from player.render.cpu import render_splats
from tests.support.tiny_stream import tiny_manifest, write_tiny

Floats = npt.NDArray[np.float32]


def manifest_of(width_px: int, height_px: int, fps: float) -> Manifest:
    w2c = np.eye(4)
    w2c[2, 3] = 6.0
    size = (width_px, height_px, width_px, width_px, width_px / 2, height_px / 2)
    cameras = (Camera("front", *size, w2c),)
    return replace(tiny_manifest(), cameras=cameras, fps=fps, storyboard=STORYBOARD_NAME)


def test_each_tile_shows_the_frame_of_its_place(tmp_path: Path) -> None:
    write_tiny(tmp_path / "s", 12, manifest_of(160, 90, 4.0))
    write_storyboard(tmp_path / "s", render_splats)
    sheet = Image.open(tmp_path / "s" / STORYBOARD_NAME)
    assert (sheet.format, sheet.size) == ("WEBP", (1600, 180))  # 12 tiles in rows of 10
    reader = StreamReader(tmp_path / "s")
    drawn = []
    for frame in range(12):
        splats = reader.active_splats(frame, reader.manifest.num_layers)
        picture = render_splats(splats, reader.manifest.camera(), reader.manifest.near_m)
        drawn.append(np.clip(picture, 0, 1))
    for tile in range(12):
        left_px, top_px = 160 * (tile % 10), 90 * (tile // 10)
        box = (left_px, top_px, left_px + 160, top_px + 90)
        found = np.asarray(sheet.crop(box), np.float64) / 255
        errors = [float(np.mean((picture - found) ** 2)) for picture in drawn]
        assert int(np.argmin(errors)) == tile
        assert errors[tile] < 0.04**2


@pytest.mark.parametrize("fps", [0.001, 0.5, 24, 29.97, 60, 1000])
@pytest.mark.parametrize("num_frames", [1, 2, 59, 60, 61, 601, 36_000_000])
def test_its_length_is_bounded(num_frames: int, fps: float) -> None:
    layout = StoryboardLayout.of(num_frames, fps)
    assert 1 <= layout.num_tiles <= MAX_TILES
    assert (layout.num_tiles - 1) * layout.step_frames < num_frames
    assert layout.num_tiles * layout.step_frames >= num_frames
    assert layout.columns * (layout.rows - 1) < layout.num_tiles <= layout.columns * layout.rows
    assert layout.step_frames >= math.ceil(fps / 4)


def test_noise_keeps_the_bound_and_a_plain_scene_the_aim(tmp_path: Path) -> None:
    write_tiny(tmp_path / "s", 60, manifest_of(160, 160, 4.0))
    rng = np.random.default_rng(0)

    def noise(splats: Splats, camera: Camera, near_m: float) -> Floats:
        shape = (camera.height_px, camera.width_px, 3)
        return rng.integers(0, 2, shape).astype(np.float32)

    write_storyboard(tmp_path / "s", noise)
    file = tmp_path / "s" / STORYBOARD_NAME
    assert AIM_BYTES < file.stat().st_size <= MAX_PICTURE_BYTES
    check_pictures(tmp_path / "s", StreamReader(tmp_path / "s").manifest)
    write_storyboard(tmp_path / "s", render_splats)
    assert file.stat().st_size <= AIM_BYTES
    file.write_bytes(b"<html>")
    with pytest.raises(CorruptError, match="does not begin as image/webp"):
        check_pictures(tmp_path / "s", StreamReader(tmp_path / "s").manifest)


def test_the_manifest_may_lack_it() -> None:
    with_one = manifest_of(64, 48, 30.0)
    without = replace(with_one, storyboard=None)
    assert Manifest.from_json(with_one.to_json()).storyboard == STORYBOARD_NAME
    assert b"storyboard" not in without.to_json()
    assert Manifest.from_json(without.to_json()).storyboard is None
    with pytest.raises(CorruptError, match="storyboard"):
        Manifest.from_json(with_one.to_json().replace(b'"storyboard.webp"', b"7"))
    with pytest.raises(InvalidError, match="storyboard"):
        replace(with_one, storyboard="a\nb.webp")
