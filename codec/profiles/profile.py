"""How much precision a stream keeps: the closed set of profiles."""

from __future__ import annotations

from enum import StrEnum

from . import compact, paper, raw
from .body import Coding


class Profile(StrEnum):
    """The name stands in the manifest, a number (`Coding.CODE`) in each chunk."""

    RAW = "raw"
    """Every float32 exactly as it was given."""

    PAPER = "paper"
    """Quantised as SwinGS does (section 5.6.2): 29 bytes a Gaussian with DC colour."""

    COMPACT = "compact"
    """Quantised as finely as the eye asks for: at most about 9 bytes a Gaussian with DC colour."""

    @property
    def coding(self) -> Coding:
        """What encodes and decodes the chunks of this profile."""
        return _CODINGS[self]


_CODINGS: dict[Profile, Coding] = {
    Profile.RAW: raw,
    Profile.PAPER: paper,
    Profile.COMPACT: compact,
}

PROFILE_OF_CODE = {profile.coding.CODE: profile for profile in Profile}
"""The profile of each number that a chunk may hold."""
