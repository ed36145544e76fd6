"""Our policy: of all that the client lacks, what is worth most per byte and cannot wait.

Every layer offers the first packet of it that can still come in time. A packet is worth what its
layer adds to the picture (index.bin), for as long as it will show, per byte; and the less the later
it is due, for it can be sent later as well:

    priority = gain_db * share of its life that is left / bytes * exp(-slack / patience)

Layer 0 counts as much as a stall costs. So the leads of the layers order themselves, layer 0 far
ahead and each other one behind the one before it, without a floor or a threshold: the link breaks
down, and the upper layers starve first; it comes back, and what is due next is mended first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from codec.errors import InvalidError

from ..holding import SliceHolding
from ..outlook import Outlook, Send, SendSlices

MOST_SHARE = 100.0
"""Of the link that a layer is taken to need: in an outage it would be any number."""


@dataclass(frozen=True, slots=True)
class SweepConfig:
    """What a `Sweep` weighs."""

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
    """What a frame of layer 0 is worth: what a stall of one frame costs, dB."""
    hold_s: float = 4.0
    """Seconds for which a layer that is taken up again is counted on, at most (version 2)."""
    settle_s: float = 0.5
    """Seconds of that which count for nothing: a layer that comes and goes is a nuisance."""
    safety: float = 0.9
    """Share of the estimated rate that is planned with."""
    least_life: float = 0.5
    """Share of a packet's life that must be left for it to be sent, except of layer 0."""

    def __post_init__(self) -> None:
        for name in ("base_patience_s", "patience_s", "stall_db"):
            if not getattr(self, name) > 0:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be positive")
        if not (0 < self.safety <= 2 and 0 <= self.least_life <= 1):
            raise InvalidError(
                f"safety is {self.safety} and least_life {self.least_life}; "
                "give over 0, at most 2, and 0 to 1"
            )


class Patience:
    """How long packets can wait, as a mean over the last seconds: what a link has done it may do
    again, but a short drop alone says little.

    Layer 0 is sent ever farther ahead for as long as the link carries more than the stream: what
    is to spare pays for it, so that nothing else comes later, and an outage finds it there.
    """

    def __init__(self, config: SweepConfig) -> None:
        self._config = config
        self._mean_s: tuple[float, float] | None = None
        self._safe_s = 0.0
        """The least patience of layer 0 that has been paid for."""
        self._at_s = 0.0

    def note(self, outlook: Outlook) -> tuple[float, float]:
        """Takes in what is estimated now; gives the patience of layer 0, and of the others."""
        config, media = self._config, outlook.media
        sizes = media.sizes(min(outlook.next_frame, media.num_frames - 1))
        base_bps, whole_bps = (
            8 * media.fps * max(1.0, num_bytes)
            for num_bytes in (sizes.slice_bytes[0], sizes.slice_bytes[-1])
        )
        ease = config.whole_share if outlook.rate_bps > whole_bps else 1.0
        base_s = config.base_patience_s * self._share(base_bps, outlook) ** 4
        base_s = self._bounded(ease * base_s)
        upper_s = self._bounded(config.patience_s * self._share(whole_bps, outlook) ** 2)
        most_s = config.left_share * self._left_s(outlook)
        if not outlook.measured:
            return min(most_s, base_s), min(most_s, upper_s)
        if self._mean_s is not None:
            since_s = outlook.now_s - self._at_s
            kept = 0.5 ** (since_s / config.memory_s)
            base_mean_s, upper_mean_s = self._mean_s
            base_s += kept * (base_mean_s - base_s)
            upper_s += kept * (upper_mean_s - upper_s)
            spare = max(0.0, outlook.rate_bps - whole_bps) / base_bps
            grown_s = self._safe_s + config.spare_share * spare * since_s
            self._safe_s = min(config.safe_patience_s, grown_s)
        self._mean_s, self._at_s = (base_s, upper_s), outlook.now_s
        return min(most_s, max(self._safe_s, base_s)), min(most_s, upper_s)

    def _share(self, need_bps: float, outlook: Outlook) -> float:
        return min(MOST_SHARE, need_bps / outlook.rate_bps)

    def _bounded(self, patience_s: float) -> float:
        config = self._config
        return min(config.most_patience_s, max(config.least_patience_s, patience_s))

    def _left_s(self, outlook: Outlook) -> float:
        """What is left to play; without end where that is not known."""
        until_frame = outlook.clock.until_frame
        if until_frame is None:
            return math.inf
        return (until_frame - outlook.next_frame) / outlook.media.fps


class SliceSweep:
    """For version 1, where each packet of a slice is worth something by itself."""

    mends = True

    def __init__(self, config: SweepConfig | None = None) -> None:
        self._config = config or SweepConfig()
        self._patience = Patience(self._config)
        self._patience_s = (0.0, 0.0)
        self._next: list[int] | None = None
        """Of each layer a birth before which no slice lacks just this layer."""
        self._paused = False
        self._ends: list[int] = []
        """Of each layer a birth from which on no slice has it."""

    def choose(self, outlook: Outlook) -> Send | None:
        holding = outlook.holding
        assert isinstance(holding, SliceHolding)
        config, media = self._config, outlook.media
        if self._next is None:
            self._ends = [holding.first_birth] * media.num_layers
        if self._next is None or outlook.paused > self._paused:
            # What was not worth it while time ran may be now.
            oldest = max(holding.first_birth, outlook.next_frame - media.swin_size + 1)
            self._next = [oldest] * media.num_layers
        self._paused = outlook.paused
        rate_bps = config.safety * outlook.rate_bps
        self._patience_s = self._patience.note(outlook)
        free_s = outlook.comes_s(0.0, rate_bps)
        best, chosen = 0.0, None
        for layer in range(outlook.num_layers):
            found = self._first(outlook, holding, layer, free_s, rate_bps)
            if found is not None and found[0] > best:
                best, chosen = found[0], (layer, found[1])
        if chosen is None:
            return None
        layer, birth = chosen
        size = media.sizes(birth).layer_bytes[layer]
        most = outlook.run_length(size, rate_bps)
        end = birth + 1
        while end < outlook.end_birth and end - birth < most and holding.level(end) == layer:
            end += 1
        self._next[layer] = end
        self._ends[layer] = max(self._ends[layer], end)
        if layer + 1 < media.num_layers:
            self._next[layer + 1] = min(self._next[layer + 1], birth)
        return SendSlices(range(birth, end), layer, layer + 1)

    def _first(
        self, outlook: Outlook, holding: SliceHolding, layer: int, free_s: float, rate_bps: float
    ) -> tuple[float, int] | None:
        """The first slice that lacks just `layer` and still shows it long enough: its priority
        and its birth."""
        assert self._next is not None
        config, media = self._config, outlook.media
        swin_size, fps = media.swin_size, media.fps
        end = min(outlook.end_birth, self._ends[layer - 1]) if layer else outlook.end_birth
        for birth in range(self._next[layer], end):
            if holding.level(birth) != layer:
                continue
            sizes = media.sizes(birth)
            size = max(1.0, sizes.layer_bytes[layer])
            slack_s = outlook.due_s(birth) - free_s - 8 * size / rate_bps
            gain_db = sizes.gains_db[layer] if layer else config.stall_db
            if layer:
                life = float(min(swin_size, birth + swin_size - outlook.clock.first_frame))
                life -= max(0.0, -slack_s) * fps
                if outlook.paused:
                    life = float(swin_size)  # what a still picture shows, it shows for long
                if life < config.least_life * swin_size:
                    continue
                gain_db *= life / swin_size
            self._next[layer] = birth
            patience_s = self._patience_s[min(layer, 1)]
            return gain_db / size * math.exp(-max(0.0, slack_s) / patience_s), birth
        return None
