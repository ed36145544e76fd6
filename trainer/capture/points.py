"""Initial points from the .npz files that captures carry."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from codec.errors import InvalidError

from ..errors import CaptureError
from .capture import InitialPoints


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
    if rgb.dtype != np.uint8:
        rgb = np.rint(np.clip(np.nan_to_num(rgb.astype(np.float64)), 0, 1) * 255).astype(np.uint8)
    try:
        return InitialPoints(xyz.astype(np.float32), np.ascontiguousarray(rgb))
    except InvalidError as error:
        raise CaptureError(f"{path}: {error}") from error
