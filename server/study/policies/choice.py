"""The policies by their names.

Rule: all callers get policies here. A new one is a file beside this one and a row of POLICIES: a
`Rule` (situation.py) that says how many layers the next group of slices gets, run by `InOrder`, or
a `Policy` (decisioncontext.py) that chooses every packet. swings-abr compares it with the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from server.abr.decisioncontext import Policy
from server.abr.media import Media
from server.abr.sweep import Sweep

from .bola import BolaRule
from .dynamic import DynamicRule
from .inorder import InOrder
from .robustmpc import MPC_GROUP_S, RobustMpcRule
from .taildrop import TailDropRule
from .throughput import ThroughputRule

PolicyFactory = Callable[[Media], Policy]
"""Makes the policy of one play of a stream."""


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
        "sweep": lambda media: Sweep(),
    }
)
"""The policies that can be compared: the published ones, and ours."""
