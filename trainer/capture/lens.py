"""Lenses by OpenCV's parameters, and their distortion taken out of pictures as they are read.

The straight picture has the size and the intrinsics of the bent one. Where the lens saw less than
the pinhole would (pincushion distortion), the nearest pixel of the edge stands in; such pixels do
not count, and neither do those that the terms of the lens fold over (`unseen_pixels`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from codec.arrays import Doubles, Flags
from codec.camera import Camera
from codec.errors import InvalidError
from codec.kernel import kernel
from trainer.errors import CaptureError

from .capture import Picture, PictureSource
from .points import MAX_COORDINATE_M

MAX_FOLDED_SHARE = 0.05
"""Share of a picture's pixels that a lens may fold over. Calibrations with k1 alone, or with too
few points near the corners, fold some; with more the lens is wrong where it matters."""


@dataclass(frozen=True, slots=True)
class Lens:
    """OpenCV's radial and tangential terms; all without unit.

    With x, y the straight position over the focal length and r2 = x^2 + y^2, the bent one is
    x (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p1 x y + p2 (r2 + 2 x^2), and for y with x, y and p1, p2
    exchanged.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def is_straight(self) -> bool:
        """Whether it bends nothing."""
        return self == Lens()


class StraightSource:
    """The pictures of a bent source, straightened. It is as thread-safe as that source.

    The bent positions are computed anew for each picture: that costs less than reading them from
    memory, where a camera's map would take four times the bytes of its picture.
    """

    def __init__(self, bent: PictureSource, camera: Camera, lens: Lens) -> None:
        self._bent, self._camera, self._lens = bent, camera, lens

    def read(self, frame: int) -> Picture:
        return straightened(self._bent.read(frame), self._camera, self._lens)

    def close(self) -> None:
        self._bent.close()


def straight_source(source: PictureSource, camera: Camera, lens: Lens) -> PictureSource:
    """The source itself, or behind a StraightSource if the lens bends."""
    return source if lens.is_straight else StraightSource(source, camera, lens)


def straightened(picture: Picture, camera: Camera, lens: Lens) -> Picture:
    """The picture as a pinhole with the camera's intrinsics sees it, sampled bilinearly."""
    straight = np.empty_like(picture)
    _straighten(
        picture, straight,
        camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px,
        lens.k1, lens.k2, lens.k3, lens.p1, lens.p2,
    )  # fmt: skip
    return straight


def check_optics(camera: Camera, lens: Lens, path: Path) -> None:
    """Raises CaptureError, naming `path`, for numbers that cannot be right.

    Those are intrinsics that no real camera has, a place too far away, and a lens that folds more
    of the picture over than MAX_FOLDED_SHARE.
    """
    for focal_px, middle_px, side_px in (
        (camera.fx_px, camera.cx_px, camera.width_px),
        (camera.fy_px, camera.cy_px, camera.height_px),
    ):
        if not (1e-2 <= focal_px / side_px <= 1e3 and abs(middle_px) <= 10 * side_px):
            raise CaptureError(
                f"{path}: camera {camera.name}: focal length {focal_px:g} px with the principal "
                f"point at {middle_px:g} px cannot be right for a side of {side_px} px"
            )
    if float(np.abs(camera.w2c[:3, 3]).max()) > MAX_COORDINATE_M:
        raise CaptureError(f"{path}: camera {camera.name}: is over {MAX_COORDINATE_M:g} m away")
    terms = (lens.k1, lens.k2, lens.k3, lens.p1, lens.p2)
    if not (np.abs(terms) < 1e6).all():
        raise CaptureError(f"{path}: camera {camera.name}: a distortion term is not a number < 1e6")
    share = folded_share(camera, lens)
    if share > MAX_FOLDED_SHARE:
        raise CaptureError(
            f"{path}: camera {camera.name}: the distortion folds {share:.0%} of the picture over, "
            f"from its corners (k1 = {lens.k1:g}, k2 = {lens.k2:g}); calibrate again or undistort "
            "the pictures first"
        )


def folded_share(camera: Camera, lens: Lens) -> float:
    """Share of the picture's pixels that the lens folds over."""
    r2 = _fold_r2(lens)
    x, y = _positions(camera)
    if not np.isfinite(r2) or np.square(x).max() + np.square(y).max() < r2:
        return 0.0
    return float((x * x + y * y >= r2).mean())


def shows_all(camera: Camera, lens: Lens) -> bool:
    """Whether `unseen_pixels` has none."""
    if lens.is_straight:
        return True
    if folded_share(camera, lens) > 0:
        return False
    # Without a fold the picture's edge stays around all of it.
    x, y = _positions(camera)
    edges = ((x, y[:1]), (x, y[-1:]), (x[:, :1], y), (x[:, -1:], y))
    return not any(_is_outside(camera, lens, *edge).any() for edge in edges)


def unseen_pixels(camera: Camera, lens: Lens) -> Flags:
    """(H, W) pixels of the straight picture that the bent one does not have, or that the lens folds
    over."""
    x, y = _positions(camera)
    return _is_outside(camera, lens, x, y) | (x * x + y * y >= _fold_r2(lens))


def _fold_r2(lens: Lens) -> float:
    """The squared straight radius from which on the bent one no longer grows, so that the lens
    would show parts of the scene twice; inf if there is none."""
    roots = np.roots([7 * lens.k3, 5 * lens.k2, 3 * lens.k1, 1.0])
    return float(np.min(roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)], initial=np.inf))


def _positions(camera: Camera) -> tuple[Doubles, Doubles]:
    """(1, W) and (H, 1) straight positions of the pixels, over the focal length."""
    x = (np.arange(camera.width_px) + 0.5 - camera.cx_px) / camera.fx_px
    y = (np.arange(camera.height_px) + 0.5 - camera.cy_px) / camera.fy_px
    return np.asarray(x[None], np.float64), np.asarray(y[:, None], np.float64)


def _is_outside(camera: Camera, lens: Lens, x: Doubles, y: Doubles) -> Flags:
    """Whether straight positions lie over half a pixel outside the bent picture's pixels."""
    r2 = x * x + y * y
    radial = 1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    bent_x = x * radial + 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x * x)
    bent_y = y * radial + 2 * lens.p2 * x * y + lens.p1 * (r2 + 2 * y * y)
    u, v = bent_x * camera.fx_px + camera.cx_px, bent_y * camera.fy_px + camera.cy_px
    return (u < 0) | (u > camera.width_px) | (v < 0) | (v > camera.height_px)


@kernel(nogil=True)
def _straighten(bent, straight, fx, fy, cx, cy, k1, k2, k3, p1, p2):  # type: ignore[no-untyped-def]
    height, width = bent.shape[:2]
    for row in range(height):
        y = (row + 0.5 - cy) / fy
        for column in range(width):
            x = (column + 0.5 - cx) / fx
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            u = (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) * fx + cx - 0.5
            v = (y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)) * fy + cy - 0.5
            u = min(max(u, 0.0), width - 1.0)
            v = min(max(v, 0.0), height - 1.0)
            left, top = int(u), int(v)
            right, low = min(left + 1, width - 1), min(top + 1, height - 1)
            a, b = u - left, v - top
            for channel in range(3):
                upper = (1 - a) * bent[top, left, channel] + a * bent[top, right, channel]
                lower = (1 - a) * bent[low, left, channel] + a * bent[low, right, channel]
                straight[row, column, channel] = np.uint8((1 - b) * upper + b * lower + 0.5)


HALF_PX = 0.5
"""OpenCV counts pixels from the middle of the first one, `Camera` from its corner."""


def camera_of_opencv(name: str, table: Mapping[str, Any], path: Path) -> tuple[Camera, Lens]:
    """The camera of size (2), matrix (3, 3), distortions (optional), rotation (a vector or (3, 3),
    world to camera) and translation (3). Raises CaptureError, naming `path`."""
    where = f"{path}: camera {name}"
    if table.get("fisheye"):
        raise CaptureError(f"{where}: fisheye lenses are not read; undistort the videos first")
    width, height = _numbers(table, "size", where, (2,))
    matrix = _numbers(table, "matrix", where, (3, 3))
    bent = _numbers(table, "distortions", where, None) if "distortions" in table else np.zeros(0)
    k1, k2, p1, p2, k3, *more = [*bent.ravel().tolist(), *[0.0] * 5]
    if any(more) or matrix[0, 1]:
        raise CaptureError(f"{where}: a skew, or more than k1, k2, p1, p2, k3, is not read")
    w2c = np.eye(4)
    w2c[:3, :3] = _rotation(table, where)
    w2c[:3, 3] = _numbers(table, "translation", where, (3,))
    (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
    lens = Lens(k1, k2, k3, p1, p2)
    try:
        camera = Camera(name, int(width), int(height), fx, fy, cx + HALF_PX, cy + HALF_PX, w2c)
    except InvalidError as error:
        raise CaptureError(f"{path}: {error}") from error
    check_optics(camera, lens, path)
    return camera, lens


def _rotation(table: Mapping[str, Any], where: str) -> Doubles:
    """(3, 3) world to camera, of a matrix or of a rotation vector, whose length is the angle."""
    given = _numbers(table, "rotation", where, None)
    if given.shape == (3, 3):
        return given
    if given.size != 3:
        raise CaptureError(f"{where}: rotation is neither rvec nor a 3x3 matrix")
    matrix: Doubles = Rotation.from_rotvec(given.ravel()).as_matrix()
    return matrix


def _numbers(
    table: Mapping[str, Any], key: str, where: str, shape: tuple[int, ...] | None
) -> Doubles:
    """The numbers of `key`, in `shape` unless that is None."""
    try:
        found = np.array(table[key], np.float64)
        found = found if shape is None else found.reshape(shape)
    except KeyError as error:
        raise CaptureError(f"{where}: has no {key}") from error
    except (TypeError, ValueError, OverflowError) as error:
        raise CaptureError(f"{where}: {key} is not numbers of the expected shape") from error
    if found.size > 64 or not np.isfinite(found).all():
        raise CaptureError(f"{where}: {key} has too many numbers, or one that is not finite")
    return found
