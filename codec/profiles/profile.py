"""How much precision a stream keeps: the closed set of profiles."""

from __future__ import annotations

from enum import StrEnum


class Profile(StrEnum):
    """The name stands in the manifest, a number (PROFILE_CODES) in each chunk."""

    RAW = "raw"
    """Every float32 exactly as it was given."""

    PAPER = "paper"
    """Quantised as SwinGS does (section 5.6.2): 29 bytes a Gaussian with DC colour."""

    COMPACT = "compact"
    """Quantised as finely as the eye asks for: at most about 9 bytes a Gaussian with DC colour."""
