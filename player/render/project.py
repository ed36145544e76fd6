"""From 3D Gaussians and a camera to 2D Gaussians on the pixel grid (EWA splatting), and the
constants of rendering recipe v1, which every back end shares.

Classic 3D Gaussian splatting: project with the Jacobian of the pinhole camera, blur by
`LOW_PASS_PX2`, blend front to back with alpha = min(ALPHA_MAX, opacity * exp(-q)), q half the
squared Mahalanobis distance in pixels. Pixel (i, j) has its centre at (i + 0.5, j + 0.5); the
background is black.

Colours of degree 2 and 3 are evaluated again only where the view turned. Those of degree 0 and 1
cost less than it costs to keep them: `project_kernel` has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Floats, Ints
from codec.camera import Camera
from codec.kernel import kernel, prange
from codec.splats import SH_C0

LOW_PASS_PX2 = 0.3
"""Added to both variances of the projected Gaussian, px^2."""

JACOBIAN_CLAMP = 1.3
"""x/z and y/z are clamped to this multiple of tan(fov/2) = size / (2 focal) inside the Jacobian."""

ALPHA_MAX = 0.99

ALPHA_MIN = 1.0 / 255.0
"""A smaller alpha is skipped."""

TRANSMITTANCE_MIN = 1e-4
"""A Gaussian that would bring a pixel's transmittance below this ends the pixel, without
contributing."""

MAX_EXTENT_SIGMA = 3.33
"""Extent of a Gaussian's box: min(this, sqrt(2 ln(255 opacity))) standard deviations."""

SH_C1 = 0.4886025119029199
SH_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
SH_C3 = (
    0.5900435899266435,
    2.890611442640554,
    0.4570457994644658,
    0.3731763325901154,
    1.445305721320277,
)
"""Constants of the real spherical harmonics of degree 1, 2 and 3, those of 3D Gaussian Splatting:
colour = max(0, 0.5 + sum of coefficients * harmonics), see codec/FORMAT.md."""

COLOUR_TURN_RAD = 0.002
"""A colour of degree 2 or 3 may be kept while the direction from the camera to the Gaussian turned
by no more than this."""

TILE_PX = 16
"""Side of a tile of the CPU rasteriser: one row of a tile is one vector of float32."""


# Columns of a projected Gaussian.
X, Y, CONIC_A, CONIC_B, CONIC_C, OPACITY, RED, GREEN, BLUE, Q_MAX = range(10)
PROJECTED = 10
"""Floats per projected Gaussian: centre (px), conic, opacity, colour, largest q that still
shows."""

# Columns of a tile box: first tile and the one after the last, in x and in y.
FIRST_X, END_X, FIRST_Y, END_Y = range(4)
TILE_BOX = 4

# Places in the camera vector: the rotation takes nine, row by row, the next two take three each.
CAM_ROTATION, CAM_TRANSLATION, CAM_POSITION = 0, 9, 12
CAM_FX, CAM_FY, CAM_CX, CAM_CY, CAM_LIMIT_X, CAM_LIMIT_Y, CAM_NEAR = range(15, 22)


def jacobian_limits(camera: Camera) -> tuple[float, float]:
    """Largest |x/z| and |y/z| that the Jacobian of the projection is taken at."""
    tan_x = 0.5 * camera.width_px / camera.fx_px
    tan_y = 0.5 * camera.height_px / camera.fy_px
    return JACOBIAN_CLAMP * tan_x, JACOBIAN_CLAMP * tan_y


def camera_vector(camera: Camera, near_m: float) -> Floats:
    """(22,) float32, places as named above: world to camera, position in the world and near plane
    in metres, intrinsics in pixels, Jacobian limits."""
    return np.concatenate(
        [
            camera.w2c[:3, :3].ravel(),
            camera.w2c[:3, 3],
            camera.position,
            [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px],
            [*jacobian_limits(camera), near_m],
        ]
    ).astype(np.float32)


@dataclass(slots=True)
class Projection:
    """M Gaussians on the pixel grid."""

    projected: Floats  # (M, 10) float32, columns as named above
    depths: Floats  # (M,) float32, metres along the viewing axis; +inf where nothing shows
    tile_boxes: Ints  # (M, 4) int32, columns as named above

    @staticmethod
    def allocate(count: int) -> Projection:
        return Projection(
            np.empty((count, PROJECTED), np.float32),
            np.empty(count, np.float32),
            np.empty((count, TILE_BOX), np.int32),
        )


@kernel(fastmath=True, inline="always")
def rotation_of(qw, qx, qy, qz):  # type: ignore[no-untyped-def]
    """The nine entries, row by row, of the rotation of a unit quaternion."""
    two = np.float32(2)
    one = np.float32(1)
    return (
        one - two * (qy * qy + qz * qz),
        two * (qx * qy - qw * qz),
        two * (qx * qz + qw * qy),
        two * (qx * qy + qw * qz),
        one - two * (qx * qx + qz * qz),
        two * (qy * qz - qw * qx),
        two * (qx * qz - qw * qy),
        two * (qy * qz + qw * qx),
        one - two * (qx * qx + qy * qy),
    )


@kernel(inline="always")
def camera_rotation(camera):  # type: ignore[no-untyped-def]
    """The nine entries, row by row, of the camera vector's rotation."""
    r = CAM_ROTATION
    return (
        camera[r], camera[r + 1], camera[r + 2],
        camera[r + 3], camera[r + 4], camera[r + 5],
        camera[r + 6], camera[r + 7], camera[r + 8],
    )  # fmt: skip


@kernel()
def depth_of(view_x, view_y, view_z, shift, x, y, z):  # type: ignore[no-untyped-def]
    """Depth of a point in exactly these float32 steps, which the shaders take, too.

    Rounded otherwise, two Gaussians that are almost equally far could change places.
    """
    return ((view_x * x + view_y * y) + view_z * z) + shift


@kernel(fastmath=True, parallel=True, nogil=True)
def project_kernel(  # type: ignore[no-untyped-def]
    means, log_scales, quats, logit_opacities, sh, rows, camera, tiles_x, tiles_y,
    projected, depths, tile_boxes,
):  # fmt: skip
    """Fills row i of `projected`, `depths` and `tile_boxes` (see Projection) from row `rows[i]` of
    the parameter arrays, for the camera vector `camera`."""
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    low_pass = np.float32(LOW_PASS_PX2)
    alpha_min = np.float32(ALPHA_MIN)
    max_extent = np.float32(MAX_EXTENT_SIGMA)
    c0, c1 = np.float32(SH_C0), np.float32(SH_C1)
    tile = np.float32(TILE_PX)
    end_x, end_y = np.float32(tiles_x), np.float32(tiles_y)
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = camera_rotation(camera)
    for i in prange(rows.shape[0]):
        row = rows[i]
        depths[i] = np.float32(np.inf)
        tile_boxes[i, FIRST_X] = 0
        tile_boxes[i, END_X] = 0
        tile_boxes[i, FIRST_Y] = 0
        tile_boxes[i, END_Y] = 0
        mx, my, mz = means[row, 0], means[row, 1], means[row, 2]
        z = depth_of(r20, r21, r22, camera[CAM_TRANSLATION + 2], mx, my, mz)
        if z <= camera[CAM_NEAR]:
            continue
        x = r00 * mx + r01 * my + r02 * mz + camera[CAM_TRANSLATION]
        y = r10 * mx + r11 * my + r12 * mz + camera[CAM_TRANSLATION + 1]
        fx, fy = camera[CAM_FX], camera[CAM_FY]
        inv_z = one / z
        u, v = x * inv_z, y * inv_z
        tx = min(max(u, -camera[CAM_LIMIT_X]), camera[CAM_LIMIT_X])
        ty = min(max(v, -camera[CAM_LIMIT_Y]), camera[CAM_LIMIT_Y])
        # (2, 3) Jacobian times the camera's rotation.
        jx, jy = fx * inv_z, fy * inv_z
        centre_x = fx * u + camera[CAM_CX]
        centre_y = fy * v + camera[CAM_CY]
        # Most of a room is beside the picture: what lies there however it is turned needs no more.
        longest = np.exp(max(log_scales[row, 0], log_scales[row, 1], log_scales[row, 2]))
        most_x = max_extent * np.sqrt((jx * longest) ** 2 * (one + tx * tx) + low_pass)
        most_y = max_extent * np.sqrt((jy * longest) ** 2 * (one + ty * ty) + low_pass)
        if (
            centre_x + most_x < zero
            or centre_y + most_y < zero
            or centre_x - most_x > end_x * tile
            or centre_y - most_y > end_y * tile
        ):
            continue
        opacity = one / (one + np.exp(-logit_opacities[row]))
        if opacity < alpha_min:
            continue
        a0, a1, a2 = jx * (r00 - tx * r20), jx * (r01 - tx * r21), jx * (r02 - tx * r22)
        b0, b1, b2 = jy * (r10 - ty * r20), jy * (r11 - ty * r21), jy * (r12 - ty * r22)
        qw, qx, qy, qz = quats[row, 0], quats[row, 1], quats[row, 2], quats[row, 3]
        norm = one / np.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        g00, g01, g02, g10, g11, g12, g20, g21, g22 = rotation_of(
            qw * norm, qx * norm, qy * norm, qz * norm
        )
        s0, s1, s2 = (
            np.exp(log_scales[row, 0]),
            np.exp(log_scales[row, 1]),
            np.exp(log_scales[row, 2]),
        )
        va0 = (a0 * g00 + a1 * g10 + a2 * g20) * s0
        va1 = (a0 * g01 + a1 * g11 + a2 * g21) * s1
        va2 = (a0 * g02 + a1 * g12 + a2 * g22) * s2
        vb0 = (b0 * g00 + b1 * g10 + b2 * g20) * s0
        vb1 = (b0 * g01 + b1 * g11 + b2 * g21) * s1
        vb2 = (b0 * g02 + b1 * g12 + b2 * g22) * s2
        cov_a = va0 * va0 + va1 * va1 + va2 * va2 + low_pass
        cov_b = va0 * vb0 + va1 * vb1 + va2 * vb2
        cov_c = vb0 * vb0 + vb1 * vb1 + vb2 * vb2 + low_pass
        det = cov_a * cov_c - cov_b * cov_b
        if not det > zero:
            continue
        inv_det = one / det
        q_max = np.log(opacity / alpha_min)
        extent = min(max_extent, np.sqrt(np.float32(2) * q_max))
        half_x, half_y = extent * np.sqrt(cov_a), extent * np.sqrt(cov_c)
        # Clamped as float32 first: a box far outside must not overflow an integer.
        x0 = min(max(np.floor((centre_x - half_x) / tile), zero), end_x)
        x1 = min(max(np.floor((centre_x + half_x) / tile) + one, zero), end_x)
        y0 = min(max(np.floor((centre_y - half_y) / tile), zero), end_y)
        y1 = min(max(np.floor((centre_y + half_y) / tile) + one, zero), end_y)
        if not (x1 > x0 and y1 > y0):
            continue
        red = half + c0 * sh[row, 0, 0]
        green = half + c0 * sh[row, 0, 1]
        blue = half + c0 * sh[row, 0, 2]
        if sh.shape[1] >= 4:
            dx, dy, dz = (
                mx - camera[CAM_POSITION],
                my - camera[CAM_POSITION + 1],
                mz - camera[CAM_POSITION + 2],
            )
            inv = c1 / np.sqrt(dx * dx + dy * dy + dz * dz)
            dx, dy, dz = dx * inv, dy * inv, dz * inv
            red += dz * sh[row, 2, 0] - dy * sh[row, 1, 0] - dx * sh[row, 3, 0]
            green += dz * sh[row, 2, 1] - dy * sh[row, 1, 1] - dx * sh[row, 3, 1]
            blue += dz * sh[row, 2, 2] - dy * sh[row, 1, 2] - dx * sh[row, 3, 2]
        projected[i, X] = centre_x
        projected[i, Y] = centre_y
        projected[i, CONIC_A] = cov_c * inv_det
        projected[i, CONIC_B] = -cov_b * inv_det
        projected[i, CONIC_C] = cov_a * inv_det
        projected[i, OPACITY] = opacity
        projected[i, RED] = max(red, zero)
        projected[i, GREEN] = max(green, zero)
        projected[i, BLUE] = max(blue, zero)
        projected[i, Q_MAX] = q_max
        depths[i] = z
        tile_boxes[i, FIRST_X] = np.int32(x0)
        tile_boxes[i, END_X] = np.int32(x1)
        tile_boxes[i, FIRST_Y] = np.int32(y0)
        tile_boxes[i, END_Y] = np.int32(y1)


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
