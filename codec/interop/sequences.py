"""Formats that hold a whole sequence in one file: which there are, and how precisely they are
written."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class SequenceFormat(StrEnum):
    """The formats of sequences that can be written."""

    FOURDGS = "4dgs"
    SPLAT4D = "splat4d"
    TSOG = "tsog"


class Precision(StrEnum):
    """How much a sequence loses, in the words of .4dgs."""

    FINE = "fine"
    DEFAULT = "default"
    COARSE = "coarse"


@dataclass(frozen=True, slots=True)
class Bounds:
    """Largest errors of a Precision."""

    position: float
    """Of each coordinate, as a share of the median standard deviation."""
    size: float
    """Of each standard deviation, as a share of it."""
    levels: int
    """Of colours and opacities, in levels of 255."""
    turn: int
    """Of each component of a quaternion, in 1/128."""


BOUNDS = {
    Precision.FINE: Bounds(0.02, 0.005, 0, 0),
    Precision.DEFAULT: Bounds(0.05, 0.02, 1, 0),
    Precision.COARSE: Bounds(0.2, 0.06, 3, 1),
}
"""Those of .4dgs, which .splat4d is written with, too: as far as its bytes allow."""

INSTALL = "pip install '.[neighbours]' in the folder of swings"
