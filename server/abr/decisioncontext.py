"""The input of a policy when packets may be sent, its possible decisions, and the policy that only
counts layers.

Rule: a policy sees one `DecisionContext` and its own state, nothing else; any policy implements
`Policy`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from codec.errors import InvalidError
from codec.stream.manifest import MAX_LAYERS

from .holding import Holding
from .media import Media, segment_start
from .playout import PlayoutClock


@dataclass(frozen=True, slots=True)
class SendSlices:
    """Send the layers first_layer..end_layer-1 of the slices `births`."""

    births: range
    first_layer: int
    end_layer: int

    def add_to(self, holding: Holding) -> None:
        """Notes in `holding` that they are there."""
        for birth in self.births:
            holding.add(birth, self.first_layer, self.end_layer)


@dataclass(frozen=True, slots=True)
class SendKeyframes:
    """Send the keyframes of these layers at `frame`, the first of a segment."""

    frame: int
    first_layer: int
    end_layer: int

    def add_to(self, holding: Holding) -> None:
        """Notes in `holding` that they are there."""
        holding.add_keyframes(self.frame, self.first_layer, self.end_layer)


Send = SendSlices | SendKeyframes


@dataclass(slots=True)
class DecisionContext:
    """The sender's knowledge of one client and its link, for one decision."""

    media: Media
    holding: Holding
    """The packets that the client will hold once everything sent has arrived."""
    clock: PlayoutClock
    """The client's playback, derived from its status reports and acknowledgements."""
    now_s: float
    rate_bps: float
    """Estimated throughput; a guess until there is an estimate."""
    measured: bool
    """Whether rate_bps is an estimate."""
    queued_bytes: float
    """Sent, but not acknowledged."""
    latency_s: float
    """Seconds from the sending of a byte over an idle link to its acknowledgement."""
    next_frame: int
    """The first frame that the client has not shown."""
    end_birth: int
    """The first slice that may not be sent yet."""
    max_lead_s: float
    """Seconds of media that may be sent ahead."""
    run_s: float
    """Seconds of the link that one answer may fill."""
    is_paused: bool = False
    """Whether the client shows a still picture of next_frame."""
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

    def choose(self, context: DecisionContext) -> Send | None:
        """The packets to send now; None if none are worth sending until something changes."""
        ...


class FixedLayers:
    """The same number of layers whatever happens: what `?layers=N` asks for.

    Sends slices in order, each complete at once. Fewer layers only where the server allows no
    more; they come back at a segment's first frame, behind its slice.
    """

    mends = False

    def __init__(self, num_layers: int) -> None:
        """num_layers: as many as there are if it is more."""
        if num_layers < 1:
            raise InvalidError(f"layers is {num_layers}; give at least 1")
        self._num_layers = num_layers

    def choose(self, context: DecisionContext) -> Send | None:
        media, holding = context.media, context.holding
        wanted = min(self._num_layers, context.num_layers)
        birth = holding.end_birth(0)
        if birth is None:
            first = segment_start(media, context.clock.first_frame)
            return SendKeyframes(first, 0, wanted) if first < context.end_birth else None
        held = next((n for n in range(wanted) if holding.end_birth(n) != birth), wanted)
        if held < wanted and (birth - 1) % media.segment_frames == 0:
            return SendKeyframes(birth - 1, held, wanted)
        if birth >= context.end_birth:
            return None
        size = media.sizes(birth).slice_bytes[held - 1]
        end = min(context.end_birth, birth + context.run_length(size, context.rate_bps))
        if held < wanted:
            # With the slice of a segment's first frame they stop: keyframes follow.
            first = segment_start(media, birth + media.segment_frames - 1)
            end = min(end, first + 1)
        return SendSlices(range(birth, end), 0, held)
