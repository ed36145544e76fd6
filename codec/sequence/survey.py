"""The survey of all files, made before the first one is written: they are read twice."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from codec.arrays import Doubles
from codec.console import listed
from codec.errors import InvalidError
from codec.interop.formats import read_splats
from codec.lattice.quantise import POSITION_PER_SIZE, position_step_m, to_luma
from codec.slots.slotlayout import MAX_SLOTS
from codec.splats import Splats

from .matching import Keys, row_keys
from .numberedfiles import FramePlace

_log = logging.getLogger(__name__)

CORE_SHARE = 0.98
"""Share of the centres, along each axis, that the bounds enclose: floaters lie far outside."""

USUAL_SHARE = 0.999
FAR = 2.0
"""A log-scale counts that is not larger, by more than FAR, than USUAL_SHARE of all."""


REACH_SHARE = 0.9999
"""Share of the Gaussians whose colours the steps must hold; the others may be sent exactly."""

ODD_FACTOR = 2.0
"""A file is odd if it has so many times fewer or more Gaussians than the usual one."""
MAX_NAMED = 5
"""Files that a warning names."""


def read_frame(place: FramePlace) -> Splats:
    """The Gaussians of one frame of a sequence. Raises a CodecError that names the file."""
    return read_splats(place, MAX_SLOTS) if isinstance(place, Path) else place.read(MAX_SLOTS)


def _nowhere(sign: float) -> Doubles:
    return np.full(3, sign * np.inf)


@dataclass
class Survey:
    """Counts and bounds of the files taken in so far."""

    num_files: int = 0
    num_gs: int = 0
    """Gaussians of the fullest file."""
    sh_degree: int = 0
    lower: Doubles = field(default_factory=lambda: _nowhere(1))  # (3,) metres
    upper: Doubles = field(default_factory=lambda: _nowhere(-1))  # (3,) metres
    size_m: float = np.inf
    """The usual size of a Gaussian, in the file where it is least."""
    lowest: float = 0.0
    highest: float = 0.0
    """The log-scales, without the few largest ones."""
    reach: float = 0.0
    """The largest magnitude of Y, Co, Cg of a harmonic coefficient, in all but very few."""
    num_moved: int = 0
    """Gaussians that are not, bit by bit, in the file before; the first file does not count."""
    num_later: int = 0
    """All Gaussians after the first file."""
    _keys: Keys | None = None  # of the file before
    _counts: list[tuple[FramePlace, int]] = field(default_factory=list)

    def take(self, place: FramePlace, splats: Splats) -> None:
        """Takes in the next file. Raises InvalidError if it does not fit those before."""
        if self.num_files and splats.sh_degree != self.sh_degree:
            raise InvalidError(
                f"{place}: SH degree {splats.sh_degree}, but the files before have "
                f"{self.sh_degree}; a sequence has only one degree: "
                f"--sh-degree {min(splats.sh_degree, self.sh_degree)} drops the higher harmonics"
            )
        keys = row_keys(splats)
        if self._keys is not None:
            self.num_later += len(keys)
            self.num_moved += int(np.count_nonzero(~np.isin(keys, self._keys)))
        self.num_files, self.sh_degree, self._keys = self.num_files + 1, splats.sh_degree, keys
        self._counts.append((place, len(splats)))
        if not len(splats):
            return
        cut = (1 - CORE_SHARE) / 2
        # Axis by axis, for the quantile takes several float64 copies of what it is given.
        lower, upper = np.transpose(
            [np.quantile(axis.astype(np.float64), (cut, 1 - cut)) for axis in splats.means.T]
        )
        lowest = float(splats.log_scales.min())
        usual = float(np.quantile(splats.log_scales, USUAL_SHARE))
        highest = min(float(splats.log_scales.max()), usual + FAR)
        if not self.num_gs:
            self.lowest, self.highest = lowest, highest
        self.lowest, self.highest = min(self.lowest, lowest), max(self.highest, highest)
        strongest = np.zeros(len(splats))
        for coefficient in splats.sh.transpose(1, 0, 2):  # one by one, which bounds the memory
            magnitudes = abs(to_luma(coefficient.astype(np.float64))).max(axis=1)
            strongest = np.maximum(strongest, magnitudes)
        reach = float(np.quantile(strongest, REACH_SHARE, method="higher"))
        self.reach = max(self.reach, reach)
        self.lower = np.minimum(self.lower, lower)
        self.upper = np.maximum(self.upper, upper)
        self.size_m = min(self.size_m, position_step_m(splats) / POSITION_PER_SIZE)
        self.num_gs = max(self.num_gs, len(splats))

    def warn_of_odd_files(self) -> None:
        """Names the files that have far fewer or far more Gaussians than the usual one: most often
        they were cut off, or belong to something else."""
        usual = float(np.median([count for _, count in self._counts] or [0]))
        odd = [
            f"{place.name} ({count})"
            for place, count in self._counts
            if not usual / ODD_FACTOR <= count <= usual * ODD_FACTOR
        ]
        if odd:
            _log.warning(
                "the usual file has %.0f Gaussians; far from it: %s", usual, listed(odd, MAX_NAMED)
            )

    @property
    def box(self) -> tuple[Doubles, Doubles]:
        """The lower and upper corner of a box with most of the centres, (3,) metres each; a single
        point, or nothing at all, still has one to look at."""
        middle = (self.lower + self.upper) / 2 if self.num_gs else np.zeros(3)
        half = (self.upper - self.lower) / 2 if self.num_gs else np.zeros(3)
        half = np.maximum(half, max(0.01 * float(half.max()), 1e-3))
        return middle - half, middle + half

    @property
    def moved_share(self) -> float:
        """Share of the Gaussians of a file that the one before does not have; 1 if unknown."""
        return self.num_moved / self.num_later if self.num_later else 1.0
