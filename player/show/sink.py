"""Pictures into files: which there can be, and a single one. filesinks.py writes many."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt
from PIL import Image

from codec.errors import InvalidError, SwingsError
from codec.files import replacing

Bytes = npt.NDArray[np.uint8]
Words = npt.NDArray[np.uint16]
Floats = npt.NDArray[np.float32]
Sound = npt.NDArray[np.int16]

VIDEO_SUFFIXES = {".mp4", ".mov"}

OTHER_SUFFIXES = {".avi", ".gif", ".jpeg", ".jpg", ".m4v", ".mkv", ".png", ".webm"}
"""Names that ask for something other than a folder."""


class SinkError(SwingsError):
    """The pictures cannot be written."""


class FrameSink(Protocol):
    """Takes pictures in frame order."""

    def write(self, frame: int, picture: Bytes | Words) -> None:
        """picture: (H, W, 3) uint8 RGB, row 0 on top; where PNGs are written also (H, W, 4) RGBA,
        or (H, W) grey of uint8 or uint16."""
        ...

    def write_sound(self, samples: Sound) -> None:
        """Adds to the sound track, if there is one. samples: (n, 2) at codec.stream.sound's
        SAMPLE_RATE."""
        ...


def to_bytes(picture: Floats) -> Bytes:
    """A picture of 0..1 in 8 bits; what is brighter is clipped."""
    return np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)


def write_png(path: Path, picture: Bytes | Words) -> None:
    """Puts the picture, (H, W, 3) RGB, (H, W, 4) RGBA or (H, W) grey of 8 or 16 bits, at `path`:
    all of it or nothing."""
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
        raise InvalidError(f"{path}: name an .mp4 or .mov file, or a folder for PNGs")
    if path.suffix.lower() in VIDEO_SUFFIXES:
        if path.is_dir():
            raise InvalidError(f"{path} is a folder")
        if not path.parent.is_dir():
            raise InvalidError(f"{path}: there is no folder {path.parent}")
    elif path.exists() and not path.is_dir():
        raise InvalidError(f"{path} is a file; name an .mp4 or .mov file, or a folder for PNGs")
    elif path.is_dir() and any(path.glob("frame_*.png")):
        raise InvalidError(f"{path} already contains frames; remove them or name another folder")
