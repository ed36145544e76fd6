"""Colours from spherical harmonics of degree 2 and 3, evaluated again only where the view turned.

The colours of degree 0 and 1 cost less than it costs to keep them: `project_kernel` has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Floats, Ints
from codec.kernel import kernel, prange
from codec.splats import SH_C0

from .project import CAM_POSITION, END_X, RED, Projection, project_kernel
from .recipe import COLOUR_TURN_RAD, SH_C1, SH_C2, SH_C3

NOWHERE_M = 1e15
"""Each coordinate of the place from which a Gaussian counts as seen that was not seen yet: farther
than any camera, and its square is still a float32."""

ALWAYS = -1.0
"""The angle that makes every colour be evaluated again."""


@dataclass(frozen=True, slots=True)
class SeenColours:
    """The colour in which each of R Gaussians was seen last, and from where."""

    dc: Floats  # (R, 1, 3) float32: the colour, as the constant harmonic that has it
    seen_from: Floats  # (R, 3) float32, metres: the camera's place in the world
    turn_rad: float = COLOUR_TURN_RAD
    """A colour stays until the direction to the camera turned by more than this."""

    @staticmethod
    def none_of(count: int, sh_degree: int) -> SeenColours:
        """Colours of `count` Gaussians that no camera saw yet; no arrays for degree 0 and 1."""
        kept = count if sh_degree > 1 else 0
        return SeenColours(
            np.zeros((kept, 1, 3), np.float32), np.full((kept, 3), NOWHERE_M, np.float32)
        )

    def forget(self, first: int, end: int, rows: Ints | slice) -> None:
        """The Gaussians `rows` of those from `first` to `end` are others now."""
        if len(self.seen_from):
            self.seen_from[first:end][rows] = NOWHERE_M


@kernel(inline="always")
def higher_harmonics(x, y, z):  # type: ignore[no-untyped-def]
    """The five real spherical harmonics of degree 2 and the seven of degree 3 at a unit vector,
    with the constants and signs of 3D Gaussian Splatting."""
    two, three, four = np.float32(2), np.float32(3), np.float32(4)
    xx, yy, zz = x * x, y * y, z * z
    c20, c21, c22 = np.float32(SH_C2[0]), np.float32(SH_C2[1]), np.float32(SH_C2[2])
    c30, c31, c32 = np.float32(SH_C3[0]), np.float32(SH_C3[1]), np.float32(SH_C3[2])
    c33, c34 = np.float32(SH_C3[3]), np.float32(SH_C3[4])
    return (
        c20 * x * y,
        -c20 * y * z,
        c21 * (two * zz - xx - yy),
        -c20 * x * z,
        c22 * (xx - yy),
        -c30 * y * (three * xx - yy),
        c31 * x * y * z,
        -c32 * y * (four * zz - xx - yy),
        c33 * z * (two * zz - three * xx - three * yy),
        -c32 * x * (four * zz - xx - yy),
        c34 * z * (xx - yy),
        -c30 * x * (xx - three * yy),
    )


@kernel(fastmath=True, parallel=True, nogil=True)
def colour_kernel(  # type: ignore[no-untyped-def]
    means, sh, rows, camera, tile_boxes, turn, dc, seen_from, projected
):  # fmt: skip
    """Brings the colours of what shows up to date, in `projected`, `dc` and `seen_from`.

    sh (R, 9 or 16, 3). Of what `rows` (M,) names, a row without a tile does not show; the others
    keep their colours while the square of the turn since is at most `turn`, rad^2. If that is
    negative, `dc` and `seen_from` may hold anything.
    """
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    c0, c1 = np.float32(SH_C0), np.float32(SH_C1)
    px, py, pz = camera[CAM_POSITION], camera[CAM_POSITION + 1], camera[CAM_POSITION + 2]
    cubic = sh.shape[1] > 9
    for i in prange(rows.shape[0]):
        if tile_boxes[i, END_X] == 0:
            continue
        row = rows[i]
        x, y, z = means[row, 0] - px, means[row, 1] - py, means[row, 2] - pz
        square = x * x + y * y + z * z
        mx, my, mz = seen_from[row, 0] - px, seen_from[row, 1] - py, seen_from[row, 2] - pz
        if turn >= zero and mx * mx + my * my + mz * mz <= turn * square:
            continue
        inv = one / np.sqrt(square)
        x, y, z = x * inv, y * inv, z * inv
        h4, h5, h6, h7, h8, h9, h10, h11, h12, h13, h14, h15 = higher_harmonics(x, y, z)
        for c in range(3):
            colour = half + c0 * sh[row, 0, c]
            colour += c1 * (z * sh[row, 2, c] - y * sh[row, 1, c] - x * sh[row, 3, c])
            colour += h4 * sh[row, 4, c] + h5 * sh[row, 5, c] + h6 * sh[row, 6, c]
            colour += h7 * sh[row, 7, c] + h8 * sh[row, 8, c]
            if cubic:
                colour += h9 * sh[row, 9, c] + h10 * sh[row, 10, c] + h11 * sh[row, 11, c]
                colour += h12 * sh[row, 12, c] + h13 * sh[row, 13, c]
                colour += h14 * sh[row, 14, c] + h15 * sh[row, 15, c]
            dc[row, 0, c] = (colour - half) / c0
            projected[i, RED + c] = max(colour, zero)
        seen_from[row, 0], seen_from[row, 1], seen_from[row, 2] = px, py, pz


def project(
    arrays: tuple[Floats, Floats, Floats, Floats, Floats],
    rows: Ints,
    camera: Floats,
    tiles_x: int,
    tiles_y: int,
    projection: Projection,
    seen: SeenColours,
) -> None:
    """Fills `projection` from the rows `rows` (M,) of `arrays`, in the order of `Splats.arrays`,
    with colours of every degree. camera: see camera_vector; seen: those of these arrays."""
    means, log_scales, quats, logits, sh = arrays
    higher = sh.shape[1] > 4
    project_kernel(
        means, log_scales, quats, logits, seen.dc if higher else sh, rows, camera,
        tiles_x, tiles_y, projection.projected, projection.depths, projection.tile_boxes,
    )  # fmt: skip
    if higher:
        turn = np.float32(np.copysign(seen.turn_rad**2, seen.turn_rad))
        colour_kernel(
            means, sh, rows, camera, projection.tile_boxes, turn,
            seen.dc, seen.seen_from, projection.projected,
        )  # fmt: skip
