"""What a policy sees when something may be sent, and what it may answer.

Rule: a policy sees one `Outlook` and its own state, nothing else; any one fits behind `Policy`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from .holding import Holding
from .media import Media
from .playout import PlayoutClock

MAX_LAYERS = 16
"""More than any stream has."""


@dataclass(frozen=True, slots=True)
class SendSlices:
    """Send of the slices `births` the layers first_layer..end_layer-1."""

    births: range
    first_layer: int
    end_layer: int

    def add_to(self, holding: Holding) -> None:
        """Notes in `holding` that they are there."""
        for birth in self.births:
            holding.add(birth, self.first_layer, self.end_layer)


@dataclass(frozen=True, slots=True)
class SendSnapshots:
    """Send the snapshots of these layers at `frame`, the first of a segment (version 2)."""

    frame: int
    first_layer: int
    end_layer: int

    def add_to(self, holding: Holding) -> None:
        """Notes in `holding` that they are there."""
        holding.add_snapshots(self.frame, self.first_layer, self.end_layer)


Send = SendSlices | SendSnapshots


@dataclass(slots=True)
class Outlook:
    """How things stand with one client, as far as the sender knows."""

    media: Media
    holding: Holding
    """What the client will hold once all that was sent has come."""
    clock: PlayoutClock
    """What it shows, judged by what it has told or acknowledged."""
    now_s: float
    rate_bps: float
    """Estimated throughput; a guess until there is an estimate."""
    measured: bool
    """Whether rate_bps is an estimate."""
    queued_bytes: float
    """Sent, but not acknowledged."""
    latency_s: float
    """From the sending of a byte over an idle link to the news that it has come."""
    next_frame: int
    """The first frame that the client has not shown."""
    end_birth: int
    """The first slice that may not be sent yet."""
    max_lead_s: float
    """Seconds of media that may be sent ahead."""
    run_s: float
    """Seconds of the link that one answer may fill."""
    paused: bool = False
    """Whether next_frame shows, and goes on to."""
    max_layers: int = MAX_LAYERS
    """Layers that may be sent, however many there are: a server under load has no more to give."""

    @property
    def num_layers(self) -> int:
        """Layers that there are to choose from."""
        return min(self.media.num_layers, self.max_layers)

    def due_s(self, birth: int) -> float:
        """When the slice shows first; now, before the client has begun to play."""
        frame = max(birth, self.clock.first_frame)
        if self.clock.started_s is None:
            return self.now_s + (frame - self.clock.first_frame) / self.media.fps
        if self.clock.stalled(self.now_s):
            return self.now_s + (frame - self.clock.end_frame) / self.media.fps
        return self.clock.due_s(frame)

    def comes_s(self, num_bytes: float, rate_bps: float) -> float:
        """When `num_bytes` that are sent now have come, over a link of `rate_bps`."""
        return self.now_s + self.latency_s + 8 * (self.queued_bytes + num_bytes) / rate_bps

    def run_length(self, num_bytes: float, rate_bps: float) -> int:
        """How many packets of `num_bytes` one answer may send over a link of `rate_bps`."""
        return max(1, int(rate_bps * self.run_s / 8 / max(1.0, num_bytes)))


class Policy(Protocol):
    """Chooses what one client is sent next."""

    @property
    def mends(self) -> bool:
        """Whether it may still send layers of a slice when layer 0 of later ones is sent."""
        ...

    def choose(self, outlook: Outlook) -> Send | None:
        """What to send now; None if nothing is worth it until something changes."""
        ...
