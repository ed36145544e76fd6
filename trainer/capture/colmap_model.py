"""COLMAP's sparse models: the three files in which it writes cameras, images and points.

Each file is binary (.bin, little endian) or text (.txt); the binary one is read if there are both.
What it says of matches (2D points, tracks) is passed over.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codec.arrays import Doubles
from codec.pose import rotation_of
from trainer.errors import CaptureError

from .camerachoice import named
from .capture import InitialPoints
from .points import checked_points

MODELS = (
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
)
"""Name and number of parameters of COLMAP's camera models, by their number in binary files."""

_PARAMETERS = dict(MODELS)
_DECLARED_COUNT = re.compile(r"#\s*Number of (?:cameras|images|points):\s*(\d+)")


@dataclass(frozen=True, slots=True)
class Optics:
    """A row of the cameras file."""

    model: str
    width_px: int
    height_px: int
    parameters: tuple[float, ...]
    """As many as the model has, pixels and distortion terms in COLMAP's order."""


@dataclass(frozen=True, slots=True)
class Posed:
    """A row of the images file."""

    name: str
    """Path of the image below the folder that COLMAP was given."""
    optics_id: int
    quaternion: tuple[float, ...]
    """(w, x, y, z) the rotation from world to camera."""
    translation: tuple[float, ...]
    """World to camera, in the model's unit."""


def find_model(root: Path) -> tuple[Path, list[str]]:
    """The folder of the model of a capture, and a line about others that are not read.

    Where COLMAP cannot join all pictures it writes several models, 0/, 1/ and so on, in no order
    of size: the one with the most images is taken, and the first of equals. Raises CaptureError.
    """
    place = root / "sparse"
    numbered = (folder for folder in place.glob("*") if folder.name.isdecimal())
    models = [
        folder
        for folder in (*sorted(numbered, key=lambda folder: int(folder.name)), place)
        if any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt"))
    ]
    if not models:
        raise CaptureError(f"{place}: neither it nor 0/ in it has cameras.bin or cameras.txt")
    if len(models) == 1:
        return models[0], []
    images = {folder: len(read_posed(folder)[1]) for folder in models if folder != place}
    chosen = max(images, key=lambda folder: images[folder])
    others = [f"{f.name} ({count})" for f, count in images.items() if f != chosen]
    if not others:
        return chosen, []
    return chosen, [
        f"{len(images)} models in {place.name}/: {chosen.name}, which has the most images "
        f"({images[chosen]}), is read, and {named(others)} is not; COLMAP could not join them"
    ]


def read_optics(folder: Path) -> tuple[Path, dict[int, Optics]]:
    """The file of cameras in a model folder and what it says, by id. Raises CaptureError."""
    path = _choose(folder, "cameras")
    rows = _optics_of_binary(path) if path.suffix == ".bin" else _optics_of_text(path)
    found: dict[int, Optics] = {}
    for key, optics in rows:
        if key in found:
            raise CaptureError(f"{path}: camera {key} is listed twice")
        found[key] = optics
    return path, found


def read_posed(folder: Path) -> tuple[Path, list[Posed]]:
    """The file of images in a model folder and what it says. Raises CaptureError."""
    path = _choose(folder, "images")
    rows = list(_posed_of_binary(path) if path.suffix == ".bin" else _posed_of_text(path))
    if not rows:
        raise CaptureError(f"{path}: has no images; the reconstruction failed")
    return path, rows


def read_model_points(folder: Path) -> InitialPoints | None:
    """The points of a model folder; None without a file of points or if it is empty. Raises
    CaptureError."""
    if not any((folder / f"points3D{suffix}").is_file() for suffix in (".bin", ".txt")):
        return None
    path = _choose(folder, "points3D")
    rows = list(_points_of_binary(path) if path.suffix == ".bin" else _points_of_text(path))
    if not rows:
        return None
    table = np.array(rows, np.float64)
    if not ((table[:, 3:] >= 0) & (table[:, 3:] <= 255)).all():
        raise CaptureError(f"{path}: a colour is not within 0..255")
    return checked_points(path, table[:, :3], table[:, 3:].astype(np.uint8))


def rotation_of_posed(posed: Posed, path: Path) -> Doubles:
    """(3, 3) the rotation from world to camera. Raises CaptureError, naming `path`, where the
    quaternion is not of unit length."""
    norm = math.hypot(*posed.quaternion)
    if not abs(norm - 1) < 1e-2:
        raise CaptureError(f"{path}: image {posed.name}: its quaternion has length {norm:g}, not 1")
    return rotation_of(np.asarray(posed.quaternion) / norm)


def _choose(folder: Path, stem: str) -> Path:
    for suffix in (".bin", ".txt"):
        if (folder / f"{stem}{suffix}").is_file():
            return folder / f"{stem}{suffix}"
    raise CaptureError(f"{folder / stem}.bin: is missing, and so is {stem}.txt")


class _Bytes:
    """A binary file, read front to back."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._data = path.read_bytes()
        except OSError as error:
            raise CaptureError(f"{path}: cannot be read: {error.strerror}") from error
        self._at = 0

    def take(self, layout: struct.Struct) -> tuple[int | float, ...]:
        """The next values."""
        start = self._skip(layout.size)
        return layout.unpack_from(self._data, start)

    def pass_over(self, count: int, size: int) -> None:
        """Skips `count` rows of `size` bytes."""
        self._skip(count * size)

    def name(self) -> str:
        """The text up to the next zero byte."""
        end = self._data.find(b"\0", self._at)
        start = self._skip((end if end >= 0 else len(self._data)) + 1 - self._at)
        try:
            return self._data[start:end].decode("utf-8")
        except UnicodeDecodeError as error:
            raise CaptureError(f"{self.path}: the name at byte {start} is not text") from error

    def end(self) -> None:
        """Raises CaptureError unless all is read."""
        if self._at != len(self._data):
            raise CaptureError(
                f"{self.path}: {len(self._data) - self._at} bytes follow the last row that it "
                "declares; export the model again"
            )

    def _skip(self, size: int) -> int:
        start = self._at
        if start + size > len(self._data):
            raise CaptureError(
                f"{self.path}: ends in the middle of a row, after {len(self._data)} bytes; "
                "the file is cut, copy it again"
            )
        self._at += size
        return start


_COUNT = struct.Struct("<Q")
_OPTICS = struct.Struct("<iiQQ")
_POSED = struct.Struct("<i7di")
_POINT = struct.Struct("<Q3d3Bd")


def _optics_of_binary(path: Path) -> Iterator[tuple[int, Optics]]:
    data = _Bytes(path)
    for _ in range(int(data.take(_COUNT)[0])):
        key, model, width, height = (int(x) for x in data.take(_OPTICS))
        if not 0 <= model < len(MODELS):
            raise CaptureError(f"{path}: camera {key} has the unknown model number {model}")
        name, number = MODELS[model]
        yield key, Optics(name, width, height, data.take(struct.Struct(f"<{number}d")))
    data.end()


def _posed_of_binary(path: Path) -> Iterator[Posed]:
    data = _Bytes(path)
    for _ in range(int(data.take(_COUNT)[0])):
        _, *pose, optics_id = data.take(_POSED)
        name = data.name()
        data.pass_over(int(data.take(_COUNT)[0]), 24)
        yield Posed(name, int(optics_id), tuple(pose[:4]), tuple(pose[4:]))
    data.end()


def _points_of_binary(path: Path) -> Iterator[tuple[float, ...]]:
    data = _Bytes(path)
    for _ in range(int(data.take(_COUNT)[0])):
        row = data.take(_POINT)
        data.pass_over(int(data.take(_COUNT)[0]), 8)
        yield row[1:7]
    data.end()


class _Lines:
    """A text file's lines with their numbers. At the end it is checked that there were as many rows
    as the header declares."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._lines = path.read_text(encoding="utf-8").split("\n")
        except (OSError, UnicodeDecodeError) as error:
            raise CaptureError(f"{path}: not text: {error}") from error

    def rows(self, with_second: bool = False) -> Iterator[tuple[int, str]]:
        """The lines that are neither empty nor comments. with_second: each of them has a second
        line, which is passed over even if it is empty."""
        declared, count, number = None, 0, 0
        while number < len(self._lines):
            line = self._lines[number].strip()
            number += 1
            if line.startswith("#"):
                found = _DECLARED_COUNT.match(line)
                declared = int(found[1]) if found else declared
            elif line:
                yield number, line
                count += 1
                number += with_second
        if declared not in (None, count):
            raise CaptureError(f"{self.path}: declares {declared} rows, has {count}; is it cut?")

    def bad(self, number: int, expected: str) -> CaptureError:
        return CaptureError(f"{self.path}: line {number} is not {expected!r}")


def _optics_of_text(path: Path) -> Iterator[tuple[int, Optics]]:
    lines = _Lines(path)
    for number, line in lines.rows():
        words = line.split()
        try:
            key, model, width, height = int(words[0]), words[1], int(words[2]), int(words[3])
            parameters = tuple(float(word) for word in words[4:])
        except (ValueError, IndexError) as error:
            raise lines.bad(number, "id MODEL width height parameters...") from error
        if len(parameters) != _PARAMETERS.get(model, len(parameters)):
            raise CaptureError(
                f"{path}: line {number}: {model} has {_PARAMETERS[model]} parameters, "
                f"not {len(parameters)}"
            )
        yield key, Optics(model, width, height, parameters)


def _posed_of_text(path: Path) -> Iterator[Posed]:
    lines = _Lines(path)
    for number, line in lines.rows(with_second=True):
        words = line.split(maxsplit=9)
        try:
            pose = [float(word) for word in words[1:8]]
            yield Posed(words[9], int(words[8]), tuple(pose[:4]), tuple(pose[4:]))
        except (ValueError, IndexError) as error:
            raise lines.bad(number, "id qw qx qy qz tx ty tz camera name") from error


def _points_of_text(path: Path) -> Iterator[tuple[float, ...]]:
    lines = _Lines(path)
    for number, line in lines.rows():
        words = line.split(maxsplit=7)
        try:
            yield tuple(float(words[i]) for i in range(1, 7))
        except (ValueError, IndexError) as error:
            raise lines.bad(number, "id x y z r g b ...") from error
