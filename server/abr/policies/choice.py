"""The policies by their names, and those that the server plays with.

Rule: whoever needs one gets it here. A new one is a file beside this one and a row of POLICIES: a
`Rule` (situation.py) that says how many layers the next group of slices gets, run by `InOrder`, or
a `Policy` (outlook.py) that chooses every packet. swings-abr compares it with the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from ..media import Media
from ..outlook import Policy
from .bola import BolaRule
from .dynamic import DynamicRule
from .fixed import FixedRule
from .inorder import InOrder
from .robustmpc import MPC_GROUP_S, RobustMpcRule
from .slotsweep import SlotSweep
from .sweep import SliceSweep
from .taildrop import TailDropRule
from .throughput import ThroughputRule

PolicyFactory = Callable[[Media], Policy]
"""Makes the policy of one play of a stream."""


def own_policy(media: Media) -> Policy:
    """Ours, for the version of `media`."""
    return SlotSweep() if media.has_slots else SliceSweep()


def fixed_policy(num_layers: int) -> Policy:
    """Always `num_layers` layers, in order: `?layers=N`."""
    return InOrder(FixedRule(num_layers))


def tail_drop(media: Media) -> Policy:
    """The paper's: slice by slice."""
    return InOrder(TailDropRule(), 1 / media.fps)


POLICIES: Mapping[str, PolicyFactory] = MappingProxyType(
    {
        "throughput": lambda media: InOrder(ThroughputRule()),
        "bola": lambda media: InOrder(BolaRule()),
        "dynamic": lambda media: InOrder(DynamicRule()),
        "robust_mpc": lambda media: InOrder(RobustMpcRule(), MPC_GROUP_S),
        "tail_drop": tail_drop,
        "sweep": own_policy,
    }
)
"""What can be compared: the published policies, and ours."""
