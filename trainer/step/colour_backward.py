"""Gradients of the colours from spherical harmonics of degree 2 and 3."""

from __future__ import annotations

import numpy as np

from codec.kernel import kernel, prange
from player.render.colours import higher_harmonics
from player.render.project import CAM_POSITION, RED
from player.render.recipe import SH_C2, SH_C3

from .blend_backward import G_RED


@kernel(inline="always")
def higher_slopes(x, y, z):  # type: ignore[no-untyped-def]
    """For each of `higher_harmonics` its three derivatives, by x, y and z."""
    zero, two, three, four = np.float32(0), np.float32(2), np.float32(3), np.float32(4)
    six, eight = np.float32(6), np.float32(8)
    xx, yy, zz = x * x, y * y, z * z
    c20, c21, c22 = np.float32(SH_C2[0]), np.float32(SH_C2[1]), np.float32(SH_C2[2])
    c30, c31, c32 = np.float32(SH_C3[0]), np.float32(SH_C3[1]), np.float32(SH_C3[2])
    c33, c34 = np.float32(SH_C3[3]), np.float32(SH_C3[4])
    return (
        (c20 * y, c20 * x, zero),
        (zero, -c20 * z, -c20 * y),
        (-two * c21 * x, -two * c21 * y, four * c21 * z),
        (-c20 * z, zero, -c20 * x),
        (two * c22 * x, -two * c22 * y, zero),
        (-six * c30 * x * y, -three * c30 * (xx - yy), zero),
        (c31 * y * z, c31 * x * z, c31 * x * y),
        (two * c32 * x * y, -c32 * (four * zz - xx - three * yy), -eight * c32 * y * z),
        (-six * c33 * x * z, -six * c33 * y * z, three * c33 * (two * zz - xx - yy)),
        (-c32 * (four * zz - three * xx - yy), two * c32 * x * y, -eight * c32 * x * z),
        (two * c34 * x * z, -two * c34 * y * z, c34 * (xx - yy)),
        (-three * c30 * (xx - yy), six * c30 * x * y, zero),
    )


@kernel(fastmath=True, parallel=True)
def colour_backward_kernel(  # type: ignore[no-untyped-def]
    means, sh, rows, trained, camera, projected, pair_starts, pair_grads, g_means, g_sh
):  # fmt: skip
    """Adds to `g_means`, and writes into `g_sh`, what comes of the harmonics of degree 2 and 3; see
    project_backward_kernel, which ran before, for the arguments."""
    zero, one = np.float32(0), np.float32(1)
    px, py, pz = camera[CAM_POSITION], camera[CAM_POSITION + 1], camera[CAM_POSITION + 2]
    count = sh.shape[1] - 4
    for k in prange(trained.shape[0]):
        i = trained[k]
        if pair_starts[i] == pair_starts[i + 1]:
            continue
        row = rows[i]
        red, green, blue = zero, zero, zero
        for pair in range(pair_starts[i], pair_starts[i + 1]):
            red += pair_grads[pair, G_RED]
            green += pair_grads[pair, G_RED + 1]
            blue += pair_grads[pair, G_RED + 2]
        # A channel cut at zero has no gradient.
        red = red if projected[i, RED] > zero else zero
        green = green if projected[i, RED + 1] > zero else zero
        blue = blue if projected[i, RED + 2] > zero else zero
        x, y, z = means[row, 0] - px, means[row, 1] - py, means[row, 2] - pz
        inv = one / np.sqrt(x * x + y * y + z * z)
        x, y, z = x * inv, y * inv, z * inv
        values, slopes = higher_harmonics(x, y, z), higher_slopes(x, y, z)
        dx, dy, dz = zero, zero, zero
        for j in range(count):
            value, slope = values[j], slopes[j]
            g_sh[row, 4 + j, 0] = value * red
            g_sh[row, 4 + j, 1] = value * green
            g_sh[row, 4 + j, 2] = value * blue
            weight = sh[row, 4 + j, 0] * red + sh[row, 4 + j, 1] * green + sh[row, 4 + j, 2] * blue
            dx += weight * slope[0]
            dy += weight * slope[1]
            dz += weight * slope[2]
        radial = dx * x + dy * y + dz * z
        g_means[row, 0] += (dx - x * radial) * inv
        g_means[row, 1] += (dy - y * radial) * inv
        g_means[row, 2] += (dz - z * radial) * inv
