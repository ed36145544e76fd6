"""Rendering recipe v1: the constants that every back end shares.

Classic 3D Gaussian splatting: project with the Jacobian of the pinhole camera, blur by
`LOW_PASS_PX2`, blend front to back with alpha = min(ALPHA_MAX, opacity * exp(-q)), q half the
squared Mahalanobis distance in pixels. Pixel (i, j) has its centre at (i + 0.5, j + 0.5); the
background is black.
"""

from codec.splats import DRAWN_SH_DEGREE

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

MAX_SH_DEGREE = DRAWN_SH_DEGREE
"""The constant and the linear harmonics are drawn; a stream may have more."""

SH_C1 = 0.4886025119029199
"""Linear spherical harmonics; colour = max(0, 0.5 + C0 s0 - C1 y s1 + C1 z s2 - C1 x s3)."""

TILE_PX = 16
"""Side of a tile of the CPU rasteriser: one row of a tile is one vector of float32."""
