"""Pictures into files: which there can be, and a single one. filesinks.py writes many."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt
from PIL import Image

from codec.arrays import Bytes, Floats
from codec.errors import InvalidError, SwingsError
from codec.files import replacing

Words = npt.NDArray[np.uint16]
Sound = npt.NDArray[np.int16]

Picture = Bytes | Words
"""(H, W, 3) uint8 RGB or (H, W, 4) RGBA, row 0 on top; or (H, W) grey of uint8 or uint16."""

VIDEO_SUFFIX = ".mp4"

OTHER_SUFFIXES = {
    *(".avi", ".exr", ".gif", ".jpeg", ".jpg", ".m4v", ".mkv", ".mov", ".png", ".webm")
}
"""Names that ask for something other than a folder."""


class SinkError(SwingsError):
    """The pictures cannot be written."""


class FrameSink(Protocol):
    """Takes pictures in frame order."""

    def write(self, frame: int, picture: Picture) -> None:
        """picture: in a video of colours."""
        ...

    def write_sound(self, samples: Sound) -> None:
        """Adds to the sound track, if there is one. samples: (n, 2) at codec.stream.sound's
        SAMPLE_RATE."""
        ...


def to_bytes(picture: Floats) -> Bytes:
    """A picture of 0..1 in 8 bits; what is brighter is clipped."""
    return np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)


def write_picture(path: Path, picture: Picture) -> None:
    """Puts the picture at `path` as PNG, all of it or nothing."""
    with replacing(path) as temporary:
        Image.fromarray(picture).save(temporary, "PNG", compress_level=4)


def check_still(path: Path) -> None:
    """Raises InvalidError when no single picture can be written to `path`."""
    if path.suffix.lower() != ".png":
        raise InvalidError(f"{path}: a still is one picture; name a .png file")
    if path.is_dir():
        raise InvalidError(f"{path} is a folder")
    if not path.parent.is_dir():
        raise InvalidError(f"{path}: there is no folder {path.parent}")


def check_output(path: Path) -> None:
    """Raises InvalidError when no capture can be written to `path`."""
    if path.suffix.lower() in OTHER_SUFFIXES:
        raise InvalidError(f"{path}: name an .mp4 file, or a folder for PNGs")
    if path.suffix.lower() == VIDEO_SUFFIX:
        if path.is_dir():
            raise InvalidError(f"{path} is a folder")
        if not path.parent.is_dir():
            raise InvalidError(f"{path}: there is no folder {path.parent}")
    elif path.exists() and not path.is_dir():
        raise InvalidError(f"{path} is a file; name an .mp4 file, or a folder for PNGs")
    elif path.is_dir() and any(path.glob("frame_*.*")):
        raise InvalidError(f"{path} already contains frames; remove them or name another folder")
