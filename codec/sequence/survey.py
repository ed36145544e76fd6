"""The frames of a sequence, files in order of number or what a container holds; and the survey of
all of them, made before the first one is written: they are read twice.
"""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from codec.arrays import Doubles
from codec.console import listed
from codec.errors import InvalidError
from codec.interop.formats import (
    READ,
    ContainedFrame,
    contained_frames,
    has_known_suffix,
    is_model_folder,
    read_splats,
)
from codec.lattice.forms import POSITION_PER_SIZE, position_step_m, to_luma
from codec.slots.slotlayout import MAX_SLOTS
from codec.splats import Splats

from .matching import Keys, row_keys

FramePlace = Path | ContainedFrame
"""Where the Gaussians of a frame are."""


def find_frames(source: Path) -> list[FramePlace]:
    """Where the frames of `source` are: in a container, one file or folder of a still model, or the
    files of a folder (`find_files`). Raises InvalidError, or a CodecError for a bad container."""
    contained = contained_frames(source)
    return [*find_files(source)] if contained is None else [*contained]


FPS_NAME = "fps.txt"
"""A file in a folder of a sequence or of pictures with the frames per second, a number."""

MAX_NAMED = 5
"""Gaps that a message names."""


def number_of(path: Path) -> int | None:
    """The last number in the name of `path`, without its suffix; None if it has none."""
    digits = re.findall(r"[0-9]+", path.stem)
    return int(digits[-1]) if digits else None


def find_files(source: Path) -> list[Path]:
    """The model `source`, or those in the folder `source`, files or folders, by the last number in
    their names.

    Numbers may begin anywhere and go on by any step that stays the same. Raises InvalidError for a
    folder without files of Gaussians, a name without a number, two names with the same number, a
    number that is missing, or a name of something else than a file.
    """
    if not source.is_dir() or is_model_folder(source):
        return [source]
    numbered: dict[int, Path] = {}
    for path in sorted(source.iterdir()):
        is_folder = is_model_folder(path)
        if path.name.startswith(".") or not (is_folder or has_known_suffix(path)):
            continue
        number = number_of(path)
        if number is None:
            raise InvalidError(f"{path}: its name has no number to sort a sequence by")
        if not (is_folder or path.is_file()):
            what = "a broken link" if path.is_symlink() else "not a regular file"
            raise InvalidError(f"{path} is {what}; replace or remove it")
        first = numbered.setdefault(number, path)
        if first is not path:
            raise InvalidError(f"{source}: {first.name} and {path.name} have the same number")
    if not numbered:
        raise InvalidError(
            f"{source}: no file of Gaussians in this folder ({READ}), and no folder with "
            "point_cloud/iteration_N/point_cloud.ply for each frame"
        )
    numbers = sorted(numbered)
    step = min((b - a for a, b in pairwise(numbers)), default=1)
    gaps = [(a, b) for a, b in pairwise(numbers) if b - a != step]
    if gaps:
        a, b = gaps[0]
        raise InvalidError(
            f"{source}: {_missing(gaps, step)} between {numbered[a].name} and {numbered[b].name}"
        )
    return [numbered[number] for number in numbers]


def _missing(gaps: list[tuple[int, int]], step: int) -> str:
    """Names the numbers that are missing in `gaps`, each given by the two numbers around it."""
    ranges = [f"{a + step}" if b - a <= 2 * step else f"{a + step} to {b - step}" for a, b in gaps]
    if len(gaps) == 1 and gaps[0][1] - gaps[0][0] <= 2 * step:
        return f"number {ranges[0]} is missing"
    if len(gaps) == 1:
        return f"numbers {ranges[0]} are missing"
    more = f" and in {len(gaps) - MAX_NAMED} more gaps" if len(gaps) > MAX_NAMED else ""
    named = ", ".join(ranges[:MAX_NAMED])
    return f"{len(gaps)} gaps; numbers {named} are missing{more}; the first is"


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
