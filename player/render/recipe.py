"""Rendering recipe v1: the constants that every back end shares.

Classic 3D Gaussian splatting: project with the Jacobian of the pinhole camera, blur by
`LOW_PASS_PX2`, blend front to back with alpha = min(ALPHA_MAX, opacity * exp(-q)), q half the
squared Mahalanobis distance in pixels. Pixel (i, j) has its centre at (i + 0.5, j + 0.5); the
background is black.
"""

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
