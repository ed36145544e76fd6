"""How much precision a stream keeps: the closed set of profiles."""

from __future__ import annotations

from enum import StrEnum

from codec.errors import InvalidError

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

    LATTICE = "lattice"
    """Integers on the lattice of the whole stream, of which only changes are sent: version 2."""

    @property
    def coding(self) -> Coding:
        """What encodes and decodes the chunks of this profile. Raises InvalidError for `lattice`,
        whose slices are not chunks by themselves."""
        if self not in _CODINGS:
            raise InvalidError(f"profile {self} has no chunks of version 1; codec/slots encodes it")
        return _CODINGS[self]


_CODINGS: dict[Profile, Coding] = {
    Profile.RAW: raw,
    Profile.PAPER: paper,
    Profile.COMPACT: compact,
}

CHUNK_PROFILES = tuple(_CODINGS)
"""The profiles of version 1, in which every chunk is decodable by itself."""

PROFILE_OF_CODE = {profile.coding.CODE: profile for profile in CHUNK_PROFILES}
"""The profile of each number that a chunk may hold."""
