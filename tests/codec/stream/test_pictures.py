"""Poster and storyboard: drawn as soon as there are frames, whole, bounded, in the folder."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.arrays import Doubles, Floats
from codec.camera import Camera
from codec.errors import CorruptError
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import Manifest
from codec.stream.pictures import (
    MAX_PICTURE_BYTES,
    check_pictures,
    find_picture,
    picture_type,
    read_picture,
)
from codec.stream.poster import (
    AIM_BYTES,
    MAX_TILES,
    POSTER_NAME,
    STORYBOARD_NAME,
    StoryboardLayout,
    write_poster,
    write_storyboard,
)
from codec.tools.audit import verify_stream
from player.render.cpu import render_splats
from tests.support.hostile import refused
from tests.support.tiny_stream import append_tiny, tiny_manifest, write_tiny


def manifest_of(
    width_px: int, height_px: int, poster: str | None = POSTER_NAME, fps: float = 25.0
) -> Manifest:
    w2c = np.eye(4)
    w2c[2, 3] = 6.0
    size = (width_px, height_px, width_px, width_px, width_px / 2, height_px / 2)
    cameras = (Camera("front", *size, w2c),)
    storyboard = STORYBOARD_NAME
    return replace(tiny_manifest(), cameras=cameras, poster=poster, fps=fps, storyboard=storyboard)


def black_and_white(splats: Splats, camera: Camera, near_m: float) -> Floats:
    """A picture of random black and white pixels, which is compressed worst."""
    shape = (camera.height_px, camera.width_px, 3)
    rng = np.random.default_rng(int(1000 * abs(float(splats.means.sum()))))
    return rng.integers(0, 2, shape).astype(np.float32)


def drawn_frames(path: Path, num_frames: int) -> list[Floats]:
    """What the default camera sees of each frame."""
    reader = StreamReader(path)
    camera, near_m = reader.manifest.camera(), reader.manifest.near_m
    frames = [reader.active_splats(n, reader.manifest.num_layers) for n in range(num_frames)]
    return [np.clip(render_splats(splats, camera, near_m), 0, 1) for splats in frames]


def rms(a: Floats, b: Doubles) -> float:
    return float(np.sqrt(np.mean((a - b) ** 2)))


def test_it_shows_what_the_default_camera_sees_of_the_first_frame(tmp_path: Path) -> None:
    write_tiny(tmp_path / "s", 6, manifest_of(320, 200))
    write_poster(tmp_path / "s", render_splats)
    shown = np.asarray(Image.open(tmp_path / "s" / POSTER_NAME), np.float64) / 255
    errors = [rms(drawn, shown) for drawn in drawn_frames(tmp_path / "s", 6)]
    assert errors[0] < 0.03
    assert min(errors[1:]) > 2 * errors[0]


@pytest.mark.parametrize(
    ("size_px", "expected_px"),
    [
        ((64, 48), (64, 48)),
        ((640, 360), (640, 360)),
        ((900, 600), (640, 427)),
        ((3840, 2160), (640, 360)),
        ((1080, 1920), (640, 1138)),
        ((500, 5000), (128, 1280)),
        ((16384, 1), (640, 1)),
    ],
)
def test_its_size_px(
    size_px: tuple[int, int], expected_px: tuple[int, int], tmp_path: Path
) -> None:
    write_tiny(tmp_path / "s", 2, manifest_of(*size_px))
    drawn_px = []

    def draw(splats: Splats, camera: Camera, near_m: float) -> Floats:
        drawn_px.append((camera.width_px, camera.height_px))
        return np.full((camera.height_px, camera.width_px, 3), 2, np.float32)

    write_poster(tmp_path / "s", draw)
    picture = Image.open(tmp_path / "s" / POSTER_NAME)
    assert (picture.format, picture.size) == ("JPEG", expected_px)
    assert picture.getextrema() == ((255, 255),) * 3
    # Never larger than the camera's picture, nor than useful.
    assert all(d <= min(s, 2 * e) for d, s, e in zip(*drawn_px, size_px, expected_px, strict=True))


def test_noise_of_the_largest_size_keeps_the_bound(tmp_path: Path) -> None:
    write_tiny(tmp_path / "s", 2, manifest_of(640, 1280))
    write_poster(tmp_path / "s", black_and_white)
    assert 1 << 19 < (tmp_path / "s" / POSTER_NAME).stat().st_size <= MAX_PICTURE_BYTES
    check_pictures(tmp_path / "s", StreamReader(tmp_path / "s").manifest)


def test_no_poster_without_a_frame_or_a_name(tmp_path: Path) -> None:
    StreamWriter.create(tmp_path / "new", manifest_of(64, 48)).abort()
    write_tiny(tmp_path / "none", 2, manifest_of(64, 48, None))
    write_tiny(tmp_path / "other", 2, manifest_of(64, 48, "other.jpg"))
    for name in ("new", "none", "other"):
        write_poster(tmp_path / name, render_splats)
        assert not list((tmp_path / name).glob("*.jpg"))


def test_a_live_stream_has_one_from_its_first_segment_on(tmp_path: Path) -> None:
    writer = StreamWriter.create(tmp_path / "s", manifest_of(64, 48))
    append_tiny(writer, 5)
    write_poster(tmp_path / "s", render_splats)
    first = (tmp_path / "s" / POSTER_NAME).read_bytes()
    append_tiny(writer, 8)
    writer.close()
    write_poster(tmp_path / "s", render_splats)
    assert (tmp_path / "s" / POSTER_NAME).read_bytes() != first
    names = sorted(path.name for path in (tmp_path / "s").iterdir())
    assert names == ["index.bin", "manifest.json", "poster.jpg", "segments"]


def picture_bytes(kind: str) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (8, 8)).save(file, kind)
    return file.getvalue()


@pytest.mark.parametrize(
    ("name", "kind"),
    [("a.jpg", "JPEG"), ("b/a.JPEG", "JPEG"), ("é #?.png", "PNG"), ("a.webp", "WEBP")],
)
def test_a_picture_must_be_what_its_name_says(name: str, kind: str, tmp_path: Path) -> None:
    manifest, path = manifest_of(64, 48, name), tmp_path / name
    assert read_picture(tmp_path, manifest.poster) is None
    check_pictures(tmp_path, manifest)  # it may be written later
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(picture_bytes(kind))
    check_pictures(tmp_path, manifest)
    assert read_picture(tmp_path, manifest.poster) == path.read_bytes()
    path.write_bytes(b"<html>")
    refused(CorruptError, r"does not begin as image/", check_pictures, tmp_path, manifest)
    path.write_bytes(picture_bytes(kind) + bytes(MAX_PICTURE_BYTES))
    refused(CorruptError, r"a poster has at most 1048576", check_pictures, tmp_path, manifest)
    assert read_picture(tmp_path, manifest.poster) is None


NOT_IN_THE_FOLDER = (
    *("", ".", "manifest.json", "a.svg", "a.jpg.html", "jpg", ".jpg", "../a.jpg", "b/../a.jpg"),
    *("link.jpg", "out/a.jpg", "folder.jpg", "https://cdn/a.jpg", "a.jpg/a.jpg", "{root}/s/a.jpg"),
)


@pytest.mark.parametrize("name", NOT_IN_THE_FOLDER)
def test_what_is_not_a_picture_in_the_folder_is_none(name: str, tmp_path: Path) -> None:
    root = tmp_path / "s"
    (root / "folder.jpg").mkdir(parents=True)
    (root / "b").mkdir()
    for path in (root / "a.jpg", root / "a.svg", root / "manifest.json", tmp_path / "a.jpg"):
        path.write_bytes(picture_bytes("JPEG"))
    (root / "link.jpg").symlink_to(tmp_path / "a.jpg")
    (root / "out").symlink_to(tmp_path)
    manifest = manifest_of(64, 48, name.replace("{root}", str(tmp_path)))
    assert find_picture(root, manifest.poster) is None
    assert read_picture(root, manifest.poster) is None
    check_pictures(root, manifest)
    assert picture_type("a.JPG") == "image/jpeg"
    assert picture_type("a.svg") is picture_type("poster") is picture_type("") is None


def test_verify_names_a_poster_that_is_wrong(tmp_path: Path) -> None:
    write_tiny(tmp_path / "s", 2, manifest_of(64, 48))
    verify_stream(tmp_path / "s")
    write_poster(tmp_path / "s", render_splats)
    verify_stream(tmp_path / "s")
    path = tmp_path / "s" / POSTER_NAME
    path.write_bytes(b"\x00" + path.read_bytes()[1:])
    with pytest.raises(CorruptError, match=f"^{path}: does not begin as image/jpeg does$"):
        verify_stream(tmp_path / "s")


def test_each_tile_shows_the_frame_of_its_place(tmp_path: Path) -> None:
    write_tiny(tmp_path / "s", 12, manifest_of(160, 90, fps=4.0))
    write_storyboard(tmp_path / "s", render_splats)
    sheet = Image.open(tmp_path / "s" / STORYBOARD_NAME)
    assert (sheet.format, sheet.size) == ("WEBP", (1600, 180))  # 12 tiles in rows of 10
    drawn = drawn_frames(tmp_path / "s", 12)
    for tile in range(12):
        left_px, top_px = 160 * (tile % 10), 90 * (tile // 10)
        box = (left_px, top_px, left_px + 160, top_px + 90)
        found = np.asarray(sheet.crop(box), np.float64) / 255
        errors = [rms(picture, found) for picture in drawn]
        assert int(np.argmin(errors)) == tile
        assert errors[tile] < 0.04


@pytest.mark.parametrize("fps", [0.001, 0.5, 24, 29.97, 60, 1000])
def test_the_length_of_a_storyboard_is_bounded(fps: float) -> None:
    for num_frames in (1, 2, 59, 60, 61, 601, 36_000_000):
        layout = StoryboardLayout.of(num_frames, fps)
        tiles, step, columns = layout.num_tiles, layout.step_frames, layout.columns
        assert 1 <= tiles <= MAX_TILES
        assert (tiles - 1) * step < num_frames <= tiles * step
        assert columns * (layout.rows - 1) < tiles <= columns * layout.rows
        assert step >= math.ceil(fps / 4)


def test_noise_keeps_the_bound_and_a_plain_scene_the_aim(tmp_path: Path) -> None:
    write_tiny(tmp_path / "s", 60, manifest_of(160, 160, fps=4.0))
    write_storyboard(tmp_path / "s", black_and_white)
    file = tmp_path / "s" / STORYBOARD_NAME
    assert AIM_BYTES < file.stat().st_size <= MAX_PICTURE_BYTES
    check_pictures(tmp_path / "s", StreamReader(tmp_path / "s").manifest)
    write_storyboard(tmp_path / "s", render_splats)
    assert file.stat().st_size <= AIM_BYTES
    file.write_bytes(b"<html>")
    with pytest.raises(CorruptError, match="does not begin as image/webp"):
        check_pictures(tmp_path / "s", StreamReader(tmp_path / "s").manifest)
