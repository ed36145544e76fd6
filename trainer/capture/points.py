"""Initial points from the .npz and .ply files that captures carry, and the depths they span."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.errors import InvalidError
from trainer.errors import CaptureError

from .capture import InitialPoints

MAX_COORDINATE_M = 1e9
"""Farthest coordinate of a point or camera that is believed, metres."""

EVENNESS_CELLS = 16
"""Cells along each side of a picture in which points are counted."""


def checked_points(
    path: Path, xyz: npt.NDArray[np.float64], rgb: npt.NDArray[np.uint8]
) -> InitialPoints:
    """The points that a file holds. Raises CaptureError, naming the file, for what are none."""
    if not len(xyz):
        raise CaptureError(f"{path}: holds no point")
    if (np.abs(xyz) > MAX_COORDINATE_M).any():
        raise CaptureError(f"{path}: a point is over {MAX_COORDINATE_M:g} m away")
    try:
        return InitialPoints(xyz.astype(np.float32), np.ascontiguousarray(rgb))
    except InvalidError as error:
        raise CaptureError(f"{path}: {error}") from error


def read_points(path: Path) -> InitialPoints:
    """The points of an .npz file in either known form. Raises CaptureError for anything else.

    Forms: `xyz` (P, 3) metres with `rgb` (P, 3), uint8 or float 0..1; or `data` (P, 6 or more) with
    columns x, y, z, r, g, b (0..1) and more that are left out, as Dynamic 3D Gaussians stores it.
    """
    try:
        with np.load(path, allow_pickle=False) as arrays:
            if "data" in arrays:
                data = np.asarray(arrays["data"], np.float64)
                if data.ndim != 2 or data.shape[1] < 6:
                    raise CaptureError(f"{path}: `data` has shape {data.shape}, not (P, 6 or more)")
                xyz, rgb = data[:, :3], data[:, 3:6]
            else:
                xyz, rgb = np.asarray(arrays["xyz"], np.float64), np.asarray(arrays["rgb"])
    except KeyError as error:
        raise CaptureError(f"{path}: has neither `data` nor `xyz` and `rgb`") from error
    except (OSError, ValueError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise CaptureError(f"{path}: not an .npz file of points: {error}") from error
    if rgb.dtype == np.uint8:
        return checked_points(path, xyz, rgb.astype(np.uint8, copy=False))
    shares = np.clip(np.nan_to_num(rgb.astype(np.float64)), 0, 1)
    return checked_points(path, xyz, np.rint(shares * 255).astype(np.uint8))


_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_PLY_COLUMNS = ("x", "y", "z", "red", "green", "blue")
MAX_PLY_POINTS = 1 << 26
"""Most points of a .ply file."""


def read_ply(path: Path) -> InitialPoints:
    """The points of a .ply file, ASCII or binary little endian. Raises CaptureError.

    Its first element must be `vertex` with x, y, z in metres and red, green, blue as uchar; other
    properties and elements are left out.
    """
    try:
        header, end, body = path.read_bytes().partition(b"end_header")
        lines = [line.split() for line in header.decode("ascii").splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{path}: not a .ply file of points: {error}") from error
    formats = [words[1] for words in lines if words[:1] == ["format"] and len(words) > 1]
    places = [i for i, words in enumerate(lines) if words[:1] == ["element"]]
    if not end or lines[:1] != [["ply"]] or not formats or not places:
        raise CaptureError(f"{path}: not a .ply file of points: no header of one")
    element, *properties = lines[places[0] : places[1] if len(places) > 1 else None]
    properties = [words for words in properties if words[:1] == ["property"]]
    if (
        element[1:2] != ["vertex"]
        or len(element) != 3
        or not element[2].isdecimal()
        or int(element[2]) > MAX_PLY_POINTS
        or any(len(words) != 3 or words[1] not in _PLY_TYPES for words in properties)
        or len({words[2] for words in properties}) != len(properties)
    ):
        raise CaptureError(f"{path}: its first element is no list of vertices")
    kinds = {words[2]: _PLY_TYPES[words[1]] for words in properties}
    if any(name not in kinds for name in _PLY_COLUMNS) or {
        kinds[name] for name in _PLY_COLUMNS[3:]
    } != {"u1"}:
        raise CaptureError(f"{path}: its vertices lack x, y, z or red, green, blue as uchar")
    count, body = int(element[2]), body.removeprefix(b"\r").removeprefix(b"\n")
    try:
        if formats[0] == "binary_little_endian":
            rows = np.frombuffer(
                body, np.dtype([(name, "<" + kind) for name, kind in kinds.items()]), count
            )
            columns = [rows[name].astype(np.float64) for name in _PLY_COLUMNS]
        elif formats[0] == "ascii":
            table = np.array(body.split()[: count * len(kinds)], np.float64)
            table = table.reshape(count, len(kinds))
            columns = [table[:, list(kinds).index(name)] for name in _PLY_COLUMNS]
        else:
            raise CaptureError(f"{path}: format {formats[0]}; write it as binary_little_endian")
    except ValueError as error:
        raise CaptureError(f"{path}: does not hold the {count} vertices that it counts") from error
    rgb = np.clip(np.nan_to_num(np.stack(columns[3:], axis=1)), 0, 255).astype(np.uint8)
    return checked_points(path, np.stack(columns[:3], axis=1), rgb)


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


def points_depths(points: InitialPoints, cameras: Sequence[Camera]) -> tuple[float, float] | None:
    """(near, far) in metres around what the cameras see of the points; None if they see nothing.

    Per camera the 0.1 and 99.9 percentiles count, because matches go astray; a tenth is added to
    either side.
    """
    bounds = []
    for camera in cameras:
        u, v, depths = camera.project(points.xyz.astype(np.float64))
        inside = (u >= 0) & (u < camera.width_px) & (v >= 0) & (v < camera.height_px)
        seen = depths[(depths > 0) & inside]
        if len(seen):
            bounds.append(np.percentile(seen, (0.1, 99.9)))
    if not bounds:
        return None
    return 0.9 * float(np.min(bounds)), 1.1 * float(np.max(bounds))
