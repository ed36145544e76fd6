"""The one vocabulary type for a set of Gaussians.

Rule: a `Splats` that exists is valid; nothing downstream checks it again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isqrt

import numpy as np
import numpy.typing as npt

from .arrays import Flags, Floats
from .errors import InvalidError

SH_C0 = 0.28209479177387814
"""The constant spherical harmonic; colour = 0.5 + SH_C0 * sh[:, 0] + ..."""

MAX_SH_DEGREE = 3


def sh_count(sh_degree: int) -> int:
    """Coefficients for each colour channel at `sh_degree`."""
    return (sh_degree + 1) ** 2


def array_shapes(count: int, sh_degree: int) -> tuple[tuple[int, ...], ...]:
    """The shapes of the arrays of `count` Gaussians, in the order of `Splats.arrays`."""
    return (count, 3), (count, 3), (count, 4), (count,), (count, sh_count(sh_degree), 3)


ARRAY_NAMES = ("means", "log_scales", "quats", "logit_opacities", "sh")
"""The arrays of a `Splats`, in the order of construction."""


@dataclass(frozen=True, slots=True, repr=False)
class Splats:
    """N Gaussians in the world frame (right-handed, metres).

    Raises InvalidError at construction when shapes disagree, a dtype is not float32, a value is not
    finite, or a quaternion is zero.
    """

    means: Floats  # (N, 3) float32, metres, world
    log_scales: Floats  # (N, 3) float32, natural log of the standard deviations in metres
    quats: Floats  # (N, 4) float32, wxyz, any norm but zero
    logit_opacities: Floats  # (N,) float32
    sh: Floats  # (N, K, 3) float32, K = (degree + 1)^2 coefficients, RGB last

    def __post_init__(self) -> None:
        n = len(self.means)
        shaped = list(zip(ARRAY_NAMES, self.arrays, array_shapes(n, 0), strict=True))
        for name, array, shape in shaped[:-1]:  # sh may be of any degree
            if array.shape != shape:
                raise InvalidError(f"Splats.{name} has shape {array.shape}, expected {shape}")
        if self.sh.ndim != 3 or self.sh.shape[0] != n or self.sh.shape[2] != 3:
            raise InvalidError(f"Splats.sh has shape {self.sh.shape}, expected ({n}, K, 3)")
        if self.sh.shape[1] not in {sh_count(d) for d in range(MAX_SH_DEGREE + 1)}:
            raise InvalidError(f"Splats.sh has {self.sh.shape[1]} coefficients, not 1, 4, 9 or 16")
        for name, array, _ in shaped:
            if array.dtype != np.float32:
                raise InvalidError(f"Splats.{name} is {array.dtype}, expected float32")
            if not np.isfinite(array).all():
                raise InvalidError(f"Splats.{name} holds a value that is not finite")
        # The four bytes of a row as one number: reducing rows of four costs ten times as much.
        if not np.not_equal(self.quats, 0, order="C").view(np.uint32).all():
            raise InvalidError("Splats.quats holds a zero quaternion")

    def __len__(self) -> int:
        return len(self.means)

    def __repr__(self) -> str:
        """The number, the SH degree and the bounds of the centres; not the arrays."""
        bounds = ""
        if len(self):
            ends = zip("xyz", self.means.min(0), self.means.max(0), strict=True)
            bounds = "".join(f", {axis} {low:.4g}..{high:.4g}" for axis, low, high in ends)
        return f"Splats({len(self)} Gaussians, SH degree {self.sh_degree}{bounds})"

    @property
    def arrays(self) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """means, log_scales, quats, logit_opacities, sh: the order of construction."""
        return self.means, self.log_scales, self.quats, self.logit_opacities, self.sh

    @property
    def num_bytes(self) -> int:
        """Bytes of all arrays in memory."""
        return sum(array.nbytes for array in self.arrays)

    @property
    def sh_degree(self) -> int:
        return isqrt(self.sh.shape[1]) - 1

    @property
    def opacities(self) -> Floats:
        """(N,) float32 in (0, 1)."""
        # tanh saturates quietly where exp would overflow.
        half = np.float32(0.5)
        opacities: Floats = half + half * np.tanh(half * self.logit_opacities)
        return opacities

    def take(self, rows: npt.NDArray[np.integer] | Flags | slice) -> Splats:
        """The Gaussians at `rows`, in that order."""
        if isinstance(rows, slice) or rows.dtype == np.bool_:
            return Splats._checked(array[rows] for array in self.arrays)
        # Several times as fast as indexing with an array.
        return Splats._checked(array.take(rows, axis=0) for array in self.arrays)

    @staticmethod
    def _checked(arrays: Iterable[Floats]) -> Splats:
        """The Gaussians of arrays that come from other Splats, whose values need no second look."""
        made = object.__new__(Splats)
        for name, array in zip(ARRAY_NAMES, arrays, strict=True):
            object.__setattr__(made, name, array)
        return made

    def with_degree(self, sh_degree: int) -> Splats:
        """These Gaussians without the harmonics above `sh_degree`, and zeros for those that they
        lack."""
        count, common = sh_count(sh_degree), min(sh_count(sh_degree), self.sh.shape[1])
        if self.sh.shape[1] == count:
            return self
        sh = np.zeros((len(self), count, 3), np.float32)
        sh[:, :common] = self.sh[:, :common]
        return Splats._checked((*self.arrays[:4], sh))

    @staticmethod
    def empty(sh_degree: int = 0) -> Splats:
        return Splats(*(np.zeros(shape, np.float32) for shape in array_shapes(0, sh_degree)))

    @staticmethod
    def concatenate(parts: Sequence[Splats]) -> Splats:
        """All of `parts`, which share one SH degree; at least one part."""
        columns = zip(*(part.arrays for part in parts), strict=True)
        return Splats._checked(np.concatenate(column) for column in columns)
