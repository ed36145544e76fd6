"""Pictures are read correctly or refused: none silently becomes white, black or empty."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from tests.support.hostile import refused
from tests.support.tiny_capture import refusal
from tests.trainer.capture.test_masks import write_layout
from trainer.errors import CaptureError
from trainer.pixels import read_grey, read_rgb

GREY = np.arange(48, dtype=np.uint8).reshape(6, 8) * 5
RGB = np.stack([GREY, 255 - GREY, GREY // 2], axis=2)


def any_size(path: Path, size: tuple[int, int]) -> None:
    """A capture that declares the size of the file."""


def save_16(path: Path, pixels: npt.NDArray[np.uint16], form: str) -> None:
    """Writes 16 bits per channel with FFmpeg's encoder, because Pillow writes only grey ones."""
    context = av.CodecContext.create({".tif": "tiff", ".png": "png"}[path.suffix], "w")
    assert isinstance(context, av.VideoCodecContext)
    context.height, context.width = pixels.shape[:2]
    context.pix_fmt, context.time_base = form, Fraction(1)
    frame = av.VideoFrame.from_ndarray(pixels, format=form)
    frame.pts = 0
    packets = [*context.encode(frame), *context.encode(None)]
    path.write_bytes(b"".join(bytes(packet) for packet in packets))


def saving(pixels: npt.NDArray[np.generic], mode: str | None = None) -> Callable[[Path], None]:
    return lambda path: Image.fromarray(pixels, mode).save(path)


def saved_with_a_transparent_colour(path: Path) -> None:
    picture = Image.fromarray(GREY // 64, "P")
    picture.putpalette([9, 8, 7, 99, 98, 97, 200, 0, 0, 0, 0, 200])
    picture.save(path, transparency=1)


def test_pictures_of_8_bits_are_as_they_are_and_16_are_rounded(tmp_path: Path) -> None:
    deep = np.linspace(0, 65535, 48).astype(np.uint16).reshape(6, 8)
    wide = RGB.astype(np.uint16) * 257
    save_16(tmp_path / "wide.png", wide, "rgb48be")
    save_16(tmp_path / "wide.tif", wide, "rgb48le")
    for suffix in ("png", "tif", "bmp"):
        saving(RGB)(tmp_path / f"rgb.{suffix}")
        saving(GREY)(tmp_path / f"grey.{suffix}")
        if suffix != "bmp":
            saving(deep)(tmp_path / f"deep.{suffix}")
    expected = {"wide": RGB, "rgb": RGB, "grey": GREY[..., None] * np.ones(3, np.uint8)}
    expected["deep"] = np.rint(deep / 257).astype(np.uint8)[..., None] * np.ones(3, np.uint8)
    for path in tmp_path.iterdir():
        found = read_rgb(path, any_size)
        assert np.array_equal(found, expected[path.stem]), path
        assert found.dtype == np.uint8
        assert found.flags.c_contiguous
        if path.stem == "deep":
            assert (read_grey(path, any_size) == found[..., 0]).all()


INDEXED = np.array([[9, 8, 7], [0, 0, 0], [200, 0, 0], [0, 0, 200]], np.uint8)[GREY // 64]


@pytest.mark.parametrize(
    ("save", "expected"),
    [
        (saving(np.dstack([RGB, np.full_like(GREY, 255)])), RGB),  # hides nothing
        (saving(np.dstack([RGB, GREY])), RGB * (GREY / 255)[..., None]),
        (saving(np.dstack([GREY, GREY]), "LA"), (GREY * (GREY / 255))[..., None] * np.ones(3)),
        (saved_with_a_transparent_colour, INDEXED),
        (lambda path: save_16(path, np.full((6, 8, 4), 0x8000, np.uint16), "rgba64be"), 64),
    ],
)
@pytest.mark.filterwarnings("ignore:'mode' parameter:DeprecationWarning")
def test_what_is_transparent_is_laid_on_black(
    save: Callable[[Path], None], expected: npt.NDArray[np.generic], tmp_path: Path
) -> None:
    path = tmp_path / "picture.png"
    save(path)
    assert np.abs(read_rgb(path, any_size) - np.asarray(expected, np.float64)).max() <= 1


@pytest.mark.filterwarnings("ignore:'mode' parameter:DeprecationWarning")
def test_what_is_not_8_or_16_bit_rgb_or_grey_is_refused(tmp_path: Path) -> None:
    bad: list[tuple[str, npt.NDArray[np.generic], str]] = [
        ("nan.tif", np.full((6, 8), np.nan, np.float32), "F"),
        ("ink.jpg", np.zeros((6, 8, 4), np.uint8), "CMYK"),
        ("deep.tif", np.full((6, 8), 1 << 20, np.int32), "I"),
    ]
    for name, pixels, mode in bad:
        saving(pixels, mode)(tmp_path / name)
        says = rf"{name}: pixels of mode {mode}"
        refused(CaptureError, says, read_rgb, tmp_path / name, any_size)


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_a_picture_of_a_billion_pixels_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "bomb.png"
    Image.fromarray(GREY).save(path)
    data = bytearray(path.read_bytes())
    data[16:24] = struct.pack(">II", 60_000, 60_000)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    path.write_bytes(data)
    for read in (read_rgb, read_grey):
        said = refused(CaptureError, r"bomb\.png: too large", read, path, any_size)
        assert "\n" not in str(said)


@pytest.mark.parametrize(
    ("layout", "name"),
    [
        ("dynerf", "poses_bounds.npy"),
        ("dynerf", "cam01.mp4"),
        ("dynamic3dgs", "ims/2/000000.png"),
        ("nerfstudio", "transforms.json"),
    ],
)
def test_nobody_waits_for_the_other_end_of_a_pipe(layout: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / "c" / name
    write_layout(tmp_path / "c", layout)
    path.unlink()
    os.mkfifo(path)
    assert path.name in refusal(tmp_path / "c")
    if path.suffix == ".png":
        refused(CaptureError, "not a regular file", read_rgb, path, any_size)


def test_damage_is_told_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    Image.fromarray(RGB).save(path)
    data = path.read_bytes()
    for size in range(0, len(data) - 16, 7):
        path.write_bytes(data[:size])
        said = refused(CaptureError, r"picture\.png", read_rgb, path, any_size)
        assert "BufferedReader" not in str(said)
