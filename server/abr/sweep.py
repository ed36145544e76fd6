"""Our policy: of all that the client lacks, what is worth most per byte and cannot wait.

A layer that is up to date offers its next change. It is worth what the layer adds to the picture
(index.bin) per byte, and the less the later it is due, for it can be sent later as well:

    priority = gain_db / bytes * exp(-slack / patience)

A layer that is behind offers the cheapest way back: the changes that it missed, the keyframe of
this segment with the changes since, or the keyframe of the next one. What that costs is weighed
against the time for which the link can keep it up.

Layer 0 counts as much as a stall costs. So the leads of the layers order themselves, layer 0 far
ahead and each other one behind the one before it, without a floor or a threshold: the link breaks
down, and the upper layers starve first; it comes back, and what is due next is mended first.

A client that is paused looks at one picture: that gets all its layers before anything else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from codec.errors import InvalidError

from .decisioncontext import DecisionContext, Send, SendKeyframes, SendSlices
from .holding import Holding
from .media import segment_start

MOST_SHARE = 100.0
"""Upper limit of the share of the link that a layer needs: in an outage it would be infinite."""


@dataclass(frozen=True, slots=True)
class SweepConfig:
    """Weights of a `Sweep`."""

    base_patience_s: float = 70.0
    """Seconds that a packet of layer 0 can wait until sending it now counts e times less, on a
    link that just carries layer 0; on one twice as fast a sixteenth of that, as what is not sent
    now is made up for sooner, and a drop is less likely to be one below layer 0."""
    whole_share: float = 0.5
    """How much of that holds on a link that carries the whole stream: there the lead can grow out
    of what is to spare, see spare_share, and takes nothing from the other layers."""
    patience_s: float = 0.4
    """The same for the other layers, on a link that just carries them all; on one twice as fast a
    fourth."""
    safe_patience_s: float = 1.2
    """The least of layer 0 in the end, on a link that carries more than the whole stream."""
    spare_share: float = 0.1
    """How fast it gets there: by this many seconds for each second of layer 0 that the link carries
    beyond the stream."""
    guessed_patience_s: float = 1.0
    """The least of layer 0 before the link is measured."""
    memory_s: float = 10.0
    """Seconds after which what a link did counts half for how long packets can wait."""
    least_patience_s: float = 0.1
    """Least of either, whatever the link."""
    most_patience_s: float = 3.0
    """Most of either, whatever the link."""
    left_share: float = 0.1
    """Most of either as a share of what is left to play: a lead that nothing is shown from any more
    was sent in vain."""
    stall_db: float = 60.0
    """Value of a frame of layer 0, which is the cost of a stall of one frame, dB."""
    hold_s: float = 4.0
    """Seconds for which a layer that is taken up again is counted on, at most."""
    settle_s: float = 0.5
    """Seconds of that which count for nothing: a layer that comes and goes is a nuisance."""
    safety: float = 0.9
    """Share of the estimated rate that is planned with."""

    def __post_init__(self) -> None:
        for name in ("base_patience_s", "patience_s", "stall_db"):
            if not getattr(self, name) > 0:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be positive")
        if not 0 < self.safety <= 2:
            raise InvalidError(f"safety is {self.safety}; give over 0, at most 2")


class UrgencyTimeConstant:
    """Time constants of urgency, for layer 0 and for the other layers, as means over the last
    seconds: what a link has done it may do again, but a short drop alone says little.

    Layer 0 is sent ever farther ahead for as long as the link carries more than the stream: what
    is to spare pays for it, so that nothing else comes later, and an outage finds it there.
    """

    def __init__(self, config: SweepConfig) -> None:
        self._config = config
        self._mean_s: tuple[float, float] | None = None
        self._safe_s = 0.0
        """The least patience of layer 0 that has been paid for."""
        self._at_s = 0.0

    def note(self, context: DecisionContext) -> tuple[float, float]:
        """Takes in what is estimated now; gives the patience of layer 0, and of the others."""
        config, media = self._config, context.media
        sizes = media.sizes(min(context.next_frame, media.num_frames - 1))
        base_bps, whole_bps = (
            8 * media.fps * max(1.0, num_bytes)
            for num_bytes in (sizes.slice_bytes[0], sizes.slice_bytes[-1])
        )
        ease = config.whole_share if context.rate_bps > whole_bps else 1.0
        base_s = config.base_patience_s * self._share(base_bps, context) ** 4
        base_s = self._bounded(ease * base_s)
        upper_s = self._bounded(config.patience_s * self._share(whole_bps, context) ** 2)
        most_s = config.left_share * self._left_s(context)
        if not context.measured:
            # Of what is sent by a guess layer 0 comes first: the link may be far thinner.
            return min(most_s, max(config.guessed_patience_s, base_s)), min(most_s, upper_s)
        if self._mean_s is not None:
            since_s = context.now_s - self._at_s
            kept = 0.5 ** (since_s / config.memory_s)
            base_mean_s, upper_mean_s = self._mean_s
            base_s += kept * (base_mean_s - base_s)
            upper_s += kept * (upper_mean_s - upper_s)
            spare = max(0.0, context.rate_bps - whole_bps) / base_bps
            grown_s = self._safe_s + config.spare_share * spare * since_s
            self._safe_s = min(config.safe_patience_s, grown_s)
        self._mean_s, self._at_s = (base_s, upper_s), context.now_s
        return min(most_s, max(self._safe_s, base_s)), min(most_s, upper_s)

    def _share(self, need_bps: float, context: DecisionContext) -> float:
        return min(MOST_SHARE, need_bps / context.rate_bps)

    def _bounded(self, patience_s: float) -> float:
        config = self._config
        return min(config.most_patience_s, max(config.least_patience_s, patience_s))

    def _left_s(self, context: DecisionContext) -> float:
        """Seconds left to play; infinite if the end is not known."""
        until_frame = context.clock.until_frame
        if until_frame is None:
            return math.inf
        return (until_frame - context.next_frame) / context.media.fps


@dataclass(frozen=True, slots=True)
class _Offer:
    """Something that could be sent, and how urgent it is."""

    priority: float
    what: Send


class Sweep:
    """Chooses packet by packet."""

    mends = True

    def __init__(self, config: SweepConfig | None = None) -> None:
        self._config = config or SweepConfig()
        self._patience = UrgencyTimeConstant(self._config)
        self._patience_s = (0.0, 0.0)

    def choose(self, context: DecisionContext) -> Send | None:
        holding = context.holding
        rate_bps = self._config.safety * context.rate_bps
        self._patience_s = self._patience.note(context)
        if context.is_paused:
            missing = _missing_of_picture(context, rate_bps)
            if missing is not None:
                return missing
        free_s = context.comes_s(0.0, rate_bps)
        best: _Offer | None = None
        end = context.end_birth
        for layer in range(context.num_layers):
            offer = self._offer(context, holding, layer, end, free_s, rate_bps)
            if offer is not None and (best is None or offer.priority > best.priority):
                best = offer
            # A layer is worth something where those before it are there.
            end = min(end, holding.end_birth(layer) or 0)
        return None if best is None else best.what

    def _offer(
        self,
        context: DecisionContext,
        holding: Holding,
        layer: int,
        end: int,
        free_s: float,
        rate_bps: float,
    ) -> _Offer | None:
        """The best that `layer` can be sent, of births before `end`."""
        config, media, fps = self._config, context.media, context.media.fps
        birth = holding.end_birth(layer)
        if layer == 0 and birth is None:
            first = segment_start(media, context.clock.first_frame)
            return _Offer(math.inf, SendKeyframes(first, 0, 1))
        if birth is not None:
            if birth >= end:
                return None
            sizes = media.sizes(birth)
            size = sizes.layer_bytes[layer]
            slack_s = context.due_s(birth) - free_s - 8 * size / rate_bps
            if layer == 0 or slack_s > -0.5 / fps:
                gain_db = sizes.gains_db[layer] if layer else config.stall_db
                patience_s = self._patience_s[min(layer, 1)]
                urgency = math.exp(-max(0.0, slack_s) / patience_s)
                births = range(birth, min(end, birth + context.run_length(size, rate_bps)))
                return _Offer(
                    gain_db / max(size, 1.0) * urgency, SendSlices(births, layer, layer + 1)
                )
        return self._way_back(context, layer, birth, end, free_s, rate_bps)

    def _way_back(
        self,
        context: DecisionContext,
        layer: int,
        birth: int | None,
        end: int,
        free_s: float,
        rate_bps: float,
    ) -> _Offer | None:
        """The best way to bring a layer up to date that is behind or not there."""
        config, media, fps = self._config, context.media, context.media.fps
        # The frame that shows when what is sent now arrives.
        frame = context.next_frame + max(0.0, (free_s - context.due_s(context.next_frame)) * fps)
        frame = min(frame, media.num_frames - 1.0)
        sizes = media.sizes(int(frame))
        size = max(1.0, sizes.layer_bytes[layer])
        gain_db = sizes.gains_db[layer]
        need_bps = 8 * fps * sizes.slice_bytes[layer]
        hold_s = config.hold_s
        if need_bps > rate_bps:
            # It lasts for as long as the leads of the layers before it do.
            lead_s = (end - frame) / fps
            hold_s = min(hold_s, lead_s * rate_bps / (need_bps - rate_bps))
        hold_s -= config.settle_s
        if hold_s <= 0 or gain_db <= 0:
            return None

        patience_s = self._patience_s[min(layer, 1)]

        def worth(cost_bytes: float, slack_s: float) -> float:
            urgency = math.exp(-max(0.0, slack_s) / patience_s)
            frames = hold_s * fps
            return (
                gain_db * frames / (cost_bytes + (frames + config.settle_s * fps) * size) * urgency
            )

        offers = []
        # While missed changes are sent, more are missed.
        ahead = 1 - 8 * fps * size / rate_bps
        first = segment_start(media, int(frame))
        if ahead > 0.05:
            if birth is not None and birth < end:
                cost = (frame - birth) * size / ahead
                births = range(birth, min(end, birth + context.run_length(size, rate_bps)))
                offers.append(_Offer(worth(cost, 0.0), SendSlices(births, layer, layer + 1)))
            if first < end and (birth is None or first > birth):
                cost = (sizes.keyframe_bytes[layer] + (frame - first) * size) / ahead
                offers.append(_Offer(worth(cost, 0.0), SendKeyframes(first, layer, layer + 1)))
        for later in (first + media.segment_frames, first + 2 * media.segment_frames):
            if later >= end:
                break
            cost = media.sizes(later).keyframe_bytes[layer]
            slack_s = context.due_s(later) - free_s - 8 * cost / rate_bps
            if slack_s >= 0:
                offers.append(_Offer(worth(cost, slack_s), SendKeyframes(later, layer, layer + 1)))
                break
        return max(offers, key=lambda offer: offer.priority, default=None)


def _missing_of_picture(context: DecisionContext, rate_bps: float) -> Send | None:
    """Sends the lowest layer that the picture of next_frame lacks; None if it lacks none."""
    media, holding = context.media, context.holding
    frame = min(context.next_frame, media.num_frames - 1)
    first = segment_start(media, frame)
    for layer in range(context.num_layers):
        birth = holding.end_birth_from(layer, frame)
        if birth is None or birth < first:
            return SendKeyframes(first, layer, layer + 1)
        if birth <= frame:
            size = media.sizes(birth).layer_bytes[layer]
            end = min(frame + 1, birth + context.run_length(size, rate_bps))
            return SendSlices(range(birth, end), layer, layer + 1)
    return None
