"""The input of a rule that decides for whole groups of slices, in order of birth.

Rule: a `Rule` sees one `Situation` and its own state, nothing else. So the published policies can
be written as their papers put them: a chunk comes, which of its sizes is it to be?
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Group:
    """A run of slices that get the same layers; the tuples have one entry for each layer count."""

    media_s: float
    """Seconds of media that show because of it; 0 of what only leads to the first frame."""
    slice_bytes: tuple[float, ...]
    """Bytes of its slices with 1, 2, ... layers; rising."""
    psnr_db: tuple[float, ...]
    """Mean PSNR with 1, 2, ... layers, dB (index.bin); rising."""
    snapshot_bytes: tuple[float, ...]
    """Bytes of the snapshots of 1, 2, ... layers at its first frame."""
    can_rise: bool
    """Whether it may get more layers than the group before it."""

    def lost_db(self, layers: int) -> float:
        """What `layers` layers lack of the PSNR of all, dB."""
        return self.psnr_db[-1] - self.psnr_db[layers - 1]

    @property
    def num_layers(self) -> int:
        return len(self.slice_bytes)

    def most_layers(self, held: int) -> int:
        """The most layers that it may get behind a group with `held`."""
        return self.num_layers if self.can_rise else max(held, 1)

    def rise_bytes(self, num_layers: int, held: int) -> float:
        """Bytes of the snapshots that raise its first frame from `held` layers to `num_layers`."""
        before = self.snapshot_bytes[held - 1] if held else 0.0
        return self.snapshot_bytes[num_layers - 1] - before if num_layers > held else 0.0

    def cost_bytes(self, num_layers: int, held: int) -> float:
        """All that it takes with `num_layers` behind a group with `held`."""
        return self.slice_bytes[num_layers - 1] + self.rise_bytes(num_layers, held)


@dataclass(frozen=True, slots=True)
class Situation:
    """The state of a play when the layers of the next group must be chosen."""

    now_s: float
    """On the clock of the session."""
    rate_bps: float
    """Estimated throughput of the last moments, bits per second; a guess until there is one."""
    measured: bool
    """Whether rate_bps is an estimate."""
    lead_s: float
    """Seconds of media that the client holds beyond what it shows when the group begins to come;
    the papers' buffer level."""
    max_lead_s: float
    """The most lead that can be had now; less than the session's where a live stream ends."""
    held: int
    """Layers of the group before; 0 at the beginning."""
    coming: tuple[Group, ...]
    """The group in question and those behind it, as many as the rule asks for or as there are."""

    @property
    def group(self) -> Group:
        return self.coming[0]

    @property
    def most_layers(self) -> int:
        return self.group.most_layers(self.held)

    def need_bps(self, num_layers: int, rise_s: float) -> float:
        """Rate at which the group is sent in the time that it is shown; the bytes of a rise are
        spread over `rise_s` seconds."""
        group = self.group
        if not group.media_s:
            return math.inf
        rise_bps = 8 * group.rise_bytes(num_layers, self.held) / rise_s
        return 8 * group.slice_bytes[num_layers - 1] / group.media_s + rise_bps


class Rule(Protocol):
    """Chooses layers for one client, group after group."""

    @property
    def horizon(self) -> int:
        """How many groups it wants to see, at least 1."""
        ...

    def choose_layers(self, situation: Situation) -> int:
        """How many layers, 1 to situation.most_layers, the group gets."""
        ...
