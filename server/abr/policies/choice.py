"""The policies that the server plays with.

Rule: whoever needs one gets it here.
"""

from __future__ import annotations

from ..media import Media
from ..outlook import Policy
from .fixed import FixedRule
from .inorder import InOrder
from .slotsweep import SlotSweep
from .sweep import SliceSweep


def own_policy(media: Media) -> Policy:
    """Ours, for the version of `media`."""
    return SlotSweep() if media.has_slots else SliceSweep()


def fixed_policy(num_layers: int) -> Policy:
    """Always `num_layers` layers, in order: `?layers=N`."""
    return InOrder(FixedRule(num_layers))
