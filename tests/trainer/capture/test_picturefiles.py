"""Pictures of every depth, with and without transparency, are read as the eye sees them."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from codec.camera import Camera
from trainer.capture.lens import Lens
from trainer.capture.masks import MaskFiles
from trainer.capture.picturefiles import FileSource
from trainer.errors import CaptureError

RAMP = np.arange(256, dtype=np.uint8).reshape(16, 16)
COLOURS = np.stack([RAMP, RAMP[::-1], RAMP.T], axis=2)


def read(path: Path) -> npt.NDArray[np.uint8]:
    camera = Camera("c", 16, 16, 20.0, 20.0, 8.0, 8.0, np.eye(4))
    picture = FileSource(camera, (path,), path).read(0)
    assert picture.shape == (16, 16, 3)
    assert picture.dtype == np.uint8
    assert picture.flags.c_contiguous
    return picture


def encoded(kind: str, layout: str, wide: npt.NDArray[np.uint16]) -> bytes:
    """A picture of 16 bits a channel by FFmpeg's encoder; PIL writes grey ones only."""
    context = av.CodecContext.create(kind, "w")
    assert isinstance(context, av.VideoCodecContext)
    context.width = context.height = 16
    context.pix_fmt, context.time_base = layout, Fraction(1)
    frame = av.VideoFrame.from_ndarray(wide, format=layout.replace("be", "le"))
    frame = frame.reformat(format=layout)
    frame.pts = 0
    return b"".join(bytes(packet) for packet in [*context.encode(frame), *context.encode(None)])


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_grey_of_16_bits(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"0.{suffix}"
    Image.fromarray(RAMP.astype(np.uint16) * 257).save(path)
    assert np.array_equal(read(path), np.stack([RAMP] * 3, axis=2))


@pytest.mark.parametrize(("kind", "layout"), [("png", "rgb48be"), ("tiff", "rgb48le")])
def test_colours_of_16_bits(tmp_path: Path, kind: str, layout: str) -> None:
    path = tmp_path / f"0.{kind}"
    path.write_bytes(encoded(kind, layout, COLOURS.astype(np.uint16) * 257))
    assert np.array_equal(read(path), COLOURS)


def test_transparency_shows_black(tmp_path: Path) -> None:
    alpha = np.zeros((16, 16), np.uint8)
    alpha[:, 5:9], alpha[:, 9:] = 128, 255
    expected = np.rint(COLOURS * (alpha[:, :, None] / 255))
    Image.fromarray(np.dstack([COLOURS, alpha])).save(tmp_path / "rgba.png")
    assert np.abs(read(tmp_path / "rgba.png") - expected).max() <= 1
    grey = Image.merge("LA", [Image.fromarray(RAMP), Image.fromarray(alpha)])
    grey.save(tmp_path / "la.png")
    expected = np.rint(np.stack([RAMP] * 3, axis=2) * (alpha[:, :, None] / 255))
    assert np.abs(read(tmp_path / "la.png") - expected).max() <= 1
    wide = np.dstack([COLOURS, np.full_like(alpha, 255)]).astype(np.uint16) * 257
    wide[:4, :, 3] = 0
    (tmp_path / "wide.png").write_bytes(encoded("png", "rgba64be", wide))
    assert not read(tmp_path / "wide.png")[:4].any()
    assert np.array_equal(read(tmp_path / "wide.png")[4:], COLOURS[4:])
    # One entry of a palette, or one colour, that counts as transparent.
    palette = Image.fromarray(RAMP % 4)
    palette.putpalette([200, 0, 0, 0, 200, 0, 0, 0, 200, 90, 90, 90])
    palette.save(tmp_path / "p.png", transparency=1)
    assert not read(tmp_path / "p.png")[RAMP % 4 == 1].any()
    assert (read(tmp_path / "p.png")[RAMP % 4 == 0] == (200, 0, 0)).all()


def test_an_opaque_alpha_changes_nothing(tmp_path: Path) -> None:
    Image.fromarray(np.dstack([COLOURS, np.full((16, 16), 255, np.uint8)])).save(tmp_path / "0.png")
    assert np.array_equal(read(tmp_path / "0.png"), COLOURS)


@pytest.mark.parametrize("kind", [np.int32, np.float32])
def test_values_of_32_bits_are_refused(tmp_path: Path, kind: type) -> None:
    path = tmp_path / "0.tif"
    Image.fromarray(RAMP.astype(kind)).save(path)
    with pytest.raises(CaptureError, match=r"0\.tif: pixels of mode [IF]"):
        read(path)


def test_a_mask_of_16_bits(tmp_path: Path) -> None:
    path = tmp_path / "0.png"
    Image.fromarray(RAMP.astype(np.uint16) * 257).save(path)
    camera = Camera("c", 16, 16, 20.0, 20.0, 8.0, 8.0, np.eye(4))
    assert np.array_equal(MaskFiles(camera, Lens(), (path,)).read(0), RAMP >= 128)
