"""How much time a coder takes to make a packet small. Decoders need not know."""

from __future__ import annotations

from enum import Enum, auto


class Effort(Enum):
    """A trade of an encoder's time against bytes."""

    QUICK = auto()
    """For a live stream, whose viewers wait; see QUICK_LEVEL."""
    USUAL = auto()
    MOST = auto()
    """Tries several ways to divide a chunk into blocks, and keeps the smallest packet."""
