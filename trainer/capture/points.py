"""Initial points from the .npz and .ply files that captures carry, and the depths they span."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from codec.arrays import Bytes, Doubles, Flags
from codec.camera import Camera, Floating
from codec.errors import CodecError, CorruptError, InvalidError, UnsupportedError
from codec.files import opened_regular
from codec.foreign.ply import BINARY, MAX_HEADER_BYTES, TEXT, PlyElement, PlyHeader, read_ply_header
from trainer.errors import CaptureError

from .capture import InitialPoints

MAX_COORDINATE_M = 1e9
"""Farthest coordinate of a point or camera that is believed, metres."""

SMALL_NPZ_BYTES = 1 << 26
"""Arrays that may be of any ratio to their file."""
MAX_NPZ_RATIO = 20
"""Bytes of larger arrays over those of their file: numbers of places hardly compress."""

EVENNESS_CELLS = 16
"""Cells along each side of a picture in which points are counted."""


def checked_points(path: Path, xyz: Doubles, rgb: Bytes) -> InitialPoints:
    """The points that the file at `path` holds. Raises CaptureError if they cannot be used."""
    if not len(xyz):
        raise CaptureError(f"{path}: holds no points")
    if (np.abs(xyz) > MAX_COORDINATE_M).any():
        raise CaptureError(f"{path}: a point is over {MAX_COORDINATE_M:g} m away")
    try:
        return InitialPoints(xyz.astype(np.float32), np.ascontiguousarray(rgb))
    except InvalidError as error:
        raise CaptureError(f"{path}: {error}") from error


_NOT_POINTS = (
    OSError, ValueError, TypeError, AttributeError, EOFError, MemoryError, zipfile.BadZipFile
)  # fmt: skip
"""The exceptions of numpy for a broken file."""


def _check_npz(path: Path, file: BinaryIO) -> None:
    """Raises CaptureError for a file whose arrays are so much longer than itself that no points can
    be in them."""
    with zipfile.ZipFile(file) as archive:
        array_bytes = sum(entry.file_size for entry in archive.infolist())
    file_bytes = os.fstat(file.fileno()).st_size
    if array_bytes > max(SMALL_NPZ_BYTES, MAX_NPZ_RATIO * file_bytes):
        raise CaptureError(
            f"{path}: {file_bytes} bytes that claim to be {array_bytes} bytes of points"
        )
    file.seek(0)


def read_points(path: Path) -> InitialPoints:
    """The points of an .npz file in either known form. Raises CaptureError for anything else.

    Forms: `xyz` (P, 3) metres with `rgb` (P, 3), uint8 or float 0..1; or `data` (P, 6 or more) with
    columns x, y, z, r, g, b (0..1) and more that are left out, as Dynamic 3D Gaussians stores it.
    """
    try:
        with opened_regular(path) as file:
            _check_npz(path, file)
            arrays = np.load(file, allow_pickle=False)
            if "data" in arrays:
                data = np.asarray(arrays["data"], np.float64)
                if data.ndim != 2 or data.shape[1] < 6:
                    raise CaptureError(f"{path}: `data` has shape {data.shape}, not (P, 6 or more)")
                xyz, rgb = data[:, :3], data[:, 3:6]
            else:
                xyz, rgb = np.asarray(arrays["xyz"], np.float64), np.asarray(arrays["rgb"])
    except KeyError as error:
        raise CaptureError(f"{path}: has neither `data` nor `xyz` and `rgb`") from error
    except CodecError as error:
        raise CaptureError(str(error)) from error
    except _NOT_POINTS as error:
        raise CaptureError(f"{path}: not an .npz file of points: {error}") from error
    if rgb.dtype == np.uint8:
        return checked_points(path, xyz, rgb.astype(np.uint8, copy=False))
    shares = np.clip(np.nan_to_num(rgb.astype(np.float64)), 0, 1)
    return checked_points(path, xyz, np.rint(shares * 255).astype(np.uint8))


_PLY_COLUMNS = ("x", "y", "z", "red", "green", "blue")
MAX_PLY_POINTS = 1 << 26
"""Most points of a .ply file."""
TEXT_BLOCK_BYTES = 1 << 20
"""Text that is parsed at a time."""

Columns = Doubles  # (P, 6) x, y, z, red, green, blue


def read_ply(path: Path) -> InitialPoints:
    """The points of a .ply file, ASCII or binary little endian. Raises CaptureError.

    Its first element must be `vertex` with x, y, z in metres and red, green, blue as uchar; other
    properties and elements are left out.
    """
    try:
        with opened_regular(path) as file:
            try:
                columns = _ply_columns(file)
            except CodecError as error:
                raise CaptureError(f"{path}: {error}") from error
    except CodecError as error:
        raise CaptureError(str(error)) from error
    rgb = np.clip(np.nan_to_num(columns[:, 3:]), 0, 255).astype(np.uint8)
    return checked_points(path, columns[:, :3], rgb)


def _ply_columns(file: BinaryIO) -> Columns:
    header = read_ply_header(file.read(MAX_HEADER_BYTES))
    vertex = _vertices(header)
    return (_text_columns if header.layout == TEXT else _binary_columns)(file, vertex)


def _vertices(header: PlyHeader) -> PlyElement:
    """The first element. Raises a CodecError unless it holds coloured points, in a known layout."""
    vertex = next(iter(header.tables.values()), None)
    if vertex is None or vertex.name != "vertex" or vertex.count > MAX_PLY_POINTS:
        raise CorruptError(
            f"PLY: its first element is not a list of vertices, {MAX_PLY_POINTS} at most"
        )
    kinds = {name: vertex.dtype[name] for name in vertex.properties}
    if any(name not in kinds for name in _PLY_COLUMNS) or any(
        kinds[name] != np.uint8 for name in _PLY_COLUMNS[3:]
    ):
        raise CorruptError("PLY: its vertices lack x, y, z or red, green, blue as uchar")
    if header.layout not in (TEXT, BINARY):
        raise UnsupportedError(f"PLY: format {header.layout[:40]}; write it as {BINARY}")
    return vertex


def _binary_columns(file: BinaryIO, vertex: PlyElement) -> Columns:
    vertex.check_size(os.fstat(file.fileno()).st_size)
    file.seek(0)
    rows = vertex.rows(file.read(vertex.end))
    with np.errstate(invalid="ignore"):  # NaN is refused later
        return np.stack([rows[name].astype(np.float64) for name in _PLY_COLUMNS], axis=1)


def _text_columns(file: BinaryIO, vertex: PlyElement) -> Columns:
    width = len(vertex.properties)
    count, filled = vertex.count * width, 0
    what = f"PLY: does not hold the {vertex.count} vertices that it declares"
    if 2 * count - 1 > os.fstat(file.fileno()).st_size:  # a digit and a space for each number
        raise CorruptError(what)
    file.seek(vertex.offset)
    numbers = np.empty(count)
    try:
        for words in _words(file):
            part = words[: count - filled]
            numbers[filled : filled + len(part)] = np.array(part, np.float64)
            filled += len(part)
            if filled == count:
                break
    except ValueError as error:
        raise CorruptError(what) from error
    if filled < count:
        raise CorruptError(what)
    return numbers.reshape(-1, width)[:, [vertex.properties.index(name) for name in _PLY_COLUMNS]]


def _words(file: BinaryIO) -> Iterator[list[bytes]]:
    """The words of the rest of `file`, block by block. Raises ValueError for one longer than a
    block."""
    rest = b""
    while block := file.read(TEXT_BLOCK_BYTES):
        text = rest + block
        words = text.split()
        rest = b"" if text[-1:].isspace() else words.pop()
        if len(rest) > TEXT_BLOCK_BYTES:
            raise ValueError("a word longer than a block")
        yield words
    yield rest.split()


def read_points_file(path: Path) -> InitialPoints:
    """The points of an .npz or a .ply file. Raises CaptureError for anything else."""
    if path.suffix.lower() == ".ply":
        return read_ply(path)
    if path.suffix.lower() == ".npz":
        return read_points(path)
    raise CaptureError(f"{path}: initial points come from a .ply or an .npz file")


def points_evenness(points: InitialPoints, cameras: Sequence[Camera]) -> float:
    """How evenly the points lie over the cameras' pictures: near 1 all over, near 0 in one spot.

    The participation ratio of the counts in EVENNESS_CELLS x EVENNESS_CELLS cells, (sum n)^2 /
    (cells sum n^2), the mean over the cameras.
    """
    ratios = []
    cells = EVENNESS_CELLS
    for camera in cameras:
        u_px, v_px, depths = camera.project(points.xyz.astype(np.float64))
        column = np.floor(u_px / camera.width_px * cells)
        row = np.floor(v_px / camera.height_px * cells)
        inside = (depths > 0) & (column >= 0) & (column < cells) & (row >= 0) & (row < cells)
        cell = (row[inside] * cells + column[inside]).astype(np.int64)
        counts = np.bincount(cell, minlength=cells**2).astype(np.float64)
        ratios.append(counts.sum() ** 2 / (cells**2 * max(float(counts @ counts), 1.0)))
    return float(np.mean(ratios))


def depths_in_view(camera: Camera, places: Floating) -> Floating:
    """(V,) how deep those of the `places` (P, 3) lie that project into the camera's picture,
    metres."""
    inside, depths = _projected(camera, places)
    return depths[inside]


def in_view(camera: Camera, places: Floating) -> Flags:
    """(P,) whether each of the `places` (P, 3) projects into the camera's picture."""
    return _projected(camera, places)[0]


def _projected(camera: Camera, places: Floating) -> tuple[Flags, Floating]:
    u_px, v_px, depths = camera.project(places.astype(np.float64))
    inside = (u_px >= 0) & (u_px < camera.width_px) & (v_px >= 0) & (v_px < camera.height_px)
    return (depths > 0) & inside, depths


def points_depths(points: InitialPoints, cameras: Sequence[Camera]) -> tuple[float, float] | None:
    """(near, far) in metres around what the cameras see of the points; None if they see nothing.

    Per camera the 0.1 and 99.9 percentiles count, because matches go astray; a tenth is added to
    either side.
    """
    bounds = []
    for camera in cameras:
        seen = depths_in_view(camera, points.xyz)
        if len(seen):
            bounds.append(np.percentile(seen, (0.1, 99.9)))
    if not bounds:
        return None
    return 0.9 * float(np.min(bounds)), 1.1 * float(np.max(bounds))
