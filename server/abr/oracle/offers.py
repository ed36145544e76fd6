"""What bytes buy: frames of a layer. The linear side of a holding.

A byte of a layer shows in some frames, in all `frames` of them. Those that lie in later groups than
its own are in store; a store holds no more than all that can be sent would leave.

Rule: whatever a holding shows of a layer can be bought here for no more bytes than it took.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..media import SegmentSizes

LEAST_BYTES = 1.0
"""Packets are taken to have so many, at least; what that adds the link is given as well."""


@dataclass(frozen=True, slots=True)
class Offer:
    """Packets of a layer that come in time for a group."""

    layer: int
    group: int
    num_bytes: float
    """Of one unit: of all changes of the group, or of one packet of another kind."""
    frames: float
    """Frames of the layer that a unit shows, at most, if it is bought in parts too."""
    begins: float = 0.0
    """Of a snapshot, how many times the smallest one is in it (version 2); else 0."""
    whole: bool = False
    """Whether a unit is what all births of the group take."""


@dataclass(frozen=True, slots=True)
class Offers:
    """All that can be bought for a play."""

    offers: tuple[Offer, ...]
    stores: tuple[tuple[float, ...], ...]
    """Of each layer but layer 0, and of each group, the most frames in store behind it."""
    must_begin: bool
    """Whether a layer shows only behind a snapshot (version 2)."""
    spare_bytes: float
    """What LEAST_BYTES adds to all packets."""


def packet_bytes(sizes: SegmentSizes, layer: int) -> float:
    """Of a slice's packet, as the offers count it."""
    return max(LEAST_BYTES, sizes.layer_bytes[layer])
