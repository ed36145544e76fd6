"""Our policy where slots last: the same weighing as sweep.py, of chains of changes.

A layer that is up to date offers its next change. One that is behind offers the cheapest way back:
the changes that it missed, the snapshot of this segment with the changes since, or the snapshot of
the next one. What that costs is weighed against the time for which the link can keep it up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..media import segment_start
from ..outlook import Outlook, Send, SendSlices, SendSnapshots
from ..slotholding import SlotHolding
from .sweep import Patience, SweepConfig


@dataclass(frozen=True, slots=True)
class _Offer:
    """Something that could be sent, and how urgent it is."""

    priority: float
    what: Send


class SlotSweep:
    """For version 2."""

    mends = True

    def __init__(self, config: SweepConfig | None = None) -> None:
        self._config = config or SweepConfig()
        self._patience = Patience(self._config)
        self._patience_s = (0.0, 0.0)

    def choose(self, outlook: Outlook) -> Send | None:
        holding = outlook.holding
        assert isinstance(holding, SlotHolding)
        rate_bps = self._config.safety * outlook.rate_bps
        self._patience_s = self._patience.note(outlook)
        free_s = outlook.comes_s(0.0, rate_bps)
        best: _Offer | None = None
        end = outlook.end_birth
        for layer in range(outlook.num_layers):
            offer = self._offer(outlook, holding, layer, end, free_s, rate_bps)
            if offer is not None and (best is None or offer.priority > best.priority):
                best = offer
            # A layer is worth something where those before it are there.
            end = min(end, holding.end_birth(layer) or 0)
        return None if best is None else best.what

    def _offer(
        self,
        outlook: Outlook,
        holding: SlotHolding,
        layer: int,
        end: int,
        free_s: float,
        rate_bps: float,
    ) -> _Offer | None:
        """The best that `layer` can be sent, of births before `end`."""
        config, media, fps = self._config, outlook.media, outlook.media.fps
        birth = holding.end_birth(layer)
        if layer == 0 and birth is None:
            first = segment_start(media, outlook.clock.first_frame)
            return _Offer(math.inf, SendSnapshots(first, 0, 1))
        if birth is not None:
            if birth >= end:
                return None
            sizes = media.sizes(birth)
            size = sizes.layer_bytes[layer]
            slack_s = outlook.due_s(birth) - free_s - 8 * size / rate_bps
            if layer == 0 or slack_s > -0.5 / fps:
                gain_db = sizes.gains_db[layer] if layer else config.stall_db
                patience_s = self._patience_s[min(layer, 1)]
                urgency = math.exp(-max(0.0, slack_s) / patience_s)
                births = range(birth, min(end, birth + outlook.run_length(size, rate_bps)))
                return _Offer(
                    gain_db / max(size, 1.0) * urgency, SendSlices(births, layer, layer + 1)
                )
        return self._way_back(outlook, holding, layer, birth, end, free_s, rate_bps)

    def _way_back(
        self,
        outlook: Outlook,
        holding: SlotHolding,
        layer: int,
        birth: int | None,
        end: int,
        free_s: float,
        rate_bps: float,
    ) -> _Offer | None:
        """The best way to bring a layer up to date that is behind or not there."""
        config, media, fps = self._config, outlook.media, outlook.media.fps
        # The frame that shows when what is sent now arrives.
        frame = outlook.next_frame + max(0.0, (free_s - outlook.due_s(outlook.next_frame)) * fps)
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
                births = range(birth, min(end, birth + outlook.run_length(size, rate_bps)))
                offers.append(_Offer(worth(cost, 0.0), SendSlices(births, layer, layer + 1)))
            if first < end and (birth is None or first > birth):
                cost = (sizes.snapshot_bytes[layer] + (frame - first) * size) / ahead
                offers.append(_Offer(worth(cost, 0.0), SendSnapshots(first, layer, layer + 1)))
        for later in (first + media.segment_frames, first + 2 * media.segment_frames):
            if later >= end:
                break
            cost = media.sizes(later).snapshot_bytes[layer]
            slack_s = outlook.due_s(later) - free_s - 8 * cost / rate_bps
            if slack_s >= 0:
                offers.append(_Offer(worth(cost, slack_s), SendSnapshots(later, layer, layer + 1)))
                break
        return max(offers, key=lambda offer: offer.priority, default=None)
