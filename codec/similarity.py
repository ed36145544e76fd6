"""Gaussians turned, mirrored, moved and scaled as one body, with the colours that go with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from .arrays import Doubles, Floats
from .camera import quat_of
from .errors import InvalidError
from .splats import MAX_SH_DEGREE, Splats

HARMONICS = ("1", *"yzx", "xy", "yz", "zz", "xz", "xx")
HARMONICS += ("xxy", "xyz", "yzz", "zzz", "xzz", "xxz", "xxx")
"""The real spherical harmonics in order, each by a product of axes of the same parity."""
SKEW = 1e-4
"""How far the axes of a matrix may be from equally long and square, as a share of their length."""


def mirrored(splats: Splats, signs: Floats) -> Splats:
    """`splats` with the axes of which `signs`, (3,) 1 or -1, is negative turned round, exactly:
    only signs change. This is how one frame becomes another."""
    x, y, z = signs
    by_axis = dict(zip("xyz", (float(sign) for sign in signs), strict=True))
    harmonics = [np.prod([by_axis.get(axis, 1.0) for axis in name]) for name in HARMONICS]
    return Splats(
        splats.means * signs,
        splats.log_scales,
        # A Gaussian is mirrored about its own centre, too, which shows in nothing.
        splats.quats * np.array([1, y * z, x * z, x * y], np.float32),
        splats.logit_opacities,
        splats.sh * np.array(harmonics, np.float32)[: splats.sh.shape[1], None],
    )


def half_turned(splats: Splats, axis: str) -> Splats:
    """`splats` after half a turn about the axis x, y or z, exactly; see `mirrored`."""
    return mirrored(splats, np.array([1 if name == axis else -1 for name in "xyz"], np.float32))


def harmonics(directions: Doubles) -> Doubles:
    """(J, 16) the real spherical harmonics of degree 0 to 3 at (J, 3) unit vectors, with the
    constants and signs of 3D Gaussian Splatting."""
    x, y, z = directions.T
    constants = (0.28209479, 0.48860251, 1.09254843, 0.31539157, 0.54627421)
    c0, c1, c2, c2z, c2x = constants
    c3, c3xyz, c3a, c3z, c3b = (0.59004359, 2.89061144, 0.45704580, 0.37317633, 1.44530572)
    terms = [c0 * np.ones_like(x), -c1 * y, c1 * z, -c1 * x]
    terms += [c2 * x * y, -c2 * y * z, c2z * (2 * z * z - x * x - y * y), -c2 * x * z]
    terms += [c2x * (x * x - y * y), -c3 * y * (3 * x * x - y * y), c3xyz * x * y * z]
    terms += [-c3a * y * (4 * z * z - x * x - y * y)]
    terms += [c3z * z * (2 * z * z - 3 * x * x - 3 * y * y)]
    terms += [-c3a * x * (4 * z * z - x * x - y * y), c3b * z * (x * x - y * y)]
    terms += [-c3 * x * (x * x - 3 * y * y)]
    return np.stack(terms, axis=1)


@cache
def _probes() -> Doubles:
    """(64, 3) unit vectors all around: a spiral of even area."""
    height = 1 - (2 * np.arange(64) + 1) / 64
    angle = np.pi * (1 + 5**0.5) * np.arange(64)
    radius = np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)


def turned_harmonics(sh: Floats, turn: Doubles) -> Floats:
    """(N, K, 3) coefficients of the colours of `sh` when what they are on is turned by `turn`, a
    (3, 3) rotation or mirroring: what was seen along d is now seen along `turn` @ d."""
    made = sh.copy()
    probes = _probes()
    new, old = harmonics(probes), harmonics(probes @ turn)
    for degree in range(1, MAX_SH_DEGREE + 1):
        band = slice(degree**2, (degree + 1) ** 2)
        if band.stop > sh.shape[1]:
            break
        # A turn mixes the harmonics of one degree with each other and with no others.
        matrix = np.linalg.lstsq(new[:, band], old[:, band], rcond=None)[0]
        made[:, band] = np.einsum("ij,njc->nic", matrix, sh[:, band].astype(np.float64))
    return made


@dataclass(frozen=True, slots=True)
class Similarity:
    """p becomes scale * turn @ p + offset."""

    scale: float
    turn: Doubles  # (3, 3) rotation, or one with a mirroring
    offset: Doubles  # (3,) metres

    @staticmethod
    def of(matrix: Doubles) -> Similarity:
        """The similarity of a (4, 4) affine matrix. Raises InvalidError for one that does more, or
        nothing that can be undone."""
        linear = matrix[:3, :3]
        with np.errstate(all="ignore"):
            scale = float(np.sqrt((linear**2).sum() / 3))
            turn = linear / scale
            square = np.abs(turn @ turn.T - np.eye(3)).max()
        if not (np.isfinite(matrix).all() and scale > 0 and square < SKEW):
            raise InvalidError("the matrix stretches or shears, or is not finite")
        if np.abs(matrix[3] - [0, 0, 0, 1]).max() > SKEW:
            raise InvalidError("the matrix is not affine")
        return Similarity(scale, turn, matrix[:3, 3])

    def moved(self, splats: Splats) -> Splats:
        """`splats` as this moves them. Raises InvalidError if they leave the range of float32."""
        # Mirroring all and then each Gaussian about its centre, which shows in nothing, is a turn.
        proper = self.turn * np.sign(np.linalg.det(self.turn))
        w, x, y, z = quat_of(proper)
        left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused below
            means = splats.means @ (self.scale * self.turn).T + self.offset
            quats = splats.quats.astype(np.float64) @ left.T
            return Splats(
                means.astype(np.float32),
                splats.log_scales + np.float32(np.log(self.scale)),
                quats.astype(np.float32),
                splats.logit_opacities,
                turned_harmonics(splats.sh, self.turn),
            )
