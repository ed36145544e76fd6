"""What is seen of slices that come whole and in order, each with a number of layers."""

from __future__ import annotations

from itertools import accumulate
from typing import Protocol

from ..media import segment_start
from .feasible import Play
from .groups import Group

Look = tuple[float, ...]
"""What later frames show of what has come so far."""
Seen = tuple[list[float], list[float], Look]
"""Of each frame of a group the bytes that come for it, and its PSNR in dB; and the look after."""

GONE = 1e-3
"""What is known less of is not known, as slotholding.py has it."""


class Looks(Protocol):
    """One for each version."""

    def begin(self) -> Look:
        """Nothing is there."""
        ...

    def advance(self, look: Look, group: Group, num_layers: int) -> Seen | None:
        """With a group of `num_layers` layers; None where they cannot be had."""
        ...


def _mixed_db(gains_db: tuple[float, ...], shares: list[float]) -> float:
    """PSNR of a frame; `shares` without layer 0."""
    return gains_db[0] + sum(g * s for g, s in zip(gains_db[1:], shares, strict=True))


class SliceLooks:
    """Version 1: the look is the number of layers of each slice that still shows."""

    def __init__(self, play: Play) -> None:
        self._play = play

    def begin(self) -> Look:
        return ()

    def advance(self, look: Look, group: Group, num_layers: int) -> Seen | None:
        media = self._play.media
        swin_size, first = media.swin_size, group.first_frame
        if first == self._play.first_frame:
            # The slices before the first frame are the first group's.
            look = (float(num_layers),) * (swin_size - 1)
        slices_bytes, psnr_db = [], []
        for frame in range(first, group.end_frame):
            slices_bytes.append(media.sizes(frame).slice_bytes[num_layers - 1])
            look = (*look, float(num_layers))
            shares = [
                sum(count > layer for count in look) / swin_size
                for layer in range(1, media.num_layers)
            ]
            psnr_db.append(_mixed_db(group.sizes.gains_db, shares))
            look = look[1:]
        if first == self._play.first_frame:
            births = range(first - swin_size + 1, first)
            slices_bytes[0] += sum(media.sizes(b).slice_bytes[num_layers - 1] for b in births)
        return slices_bytes, psnr_db, look


class SlotLooks:
    """Version 2: the look is the layers that are held, and how much is known of each but layer 0.

    A layer is taken up with its snapshot where a segment begins, or the play does.
    """

    def __init__(self, play: Play) -> None:
        self._play = play

    def begin(self) -> Look:
        return (1.0, *(0.0,) * (self._play.media.num_layers - 1))

    def advance(self, look: Look, group: Group, num_layers: int) -> Seen | None:
        play, media = self._play, self._play.media
        held, *known = look
        first = group.first_frame
        start = segment_start(media, first)
        begins = first in (start, play.first_frame)
        if num_layers > held and not begins:
            return None
        slices_bytes, psnr_db = [], []
        for frame in range(first, group.end_frame):
            sizes = media.sizes(frame)
            num_bytes = play.base_bytes[frame - play.first_frame]
            for layer in range(1, media.num_layers):
                if layer >= num_layers:
                    share = known[layer - 1] * (1 - sizes.changed_shares[layer])
                    known[layer - 1] = share if share >= GONE else 0.0
                    continue
                known[layer - 1] = 1.0
                if frame > first or layer < held:
                    num_bytes += sizes.layer_bytes[layer]
                    continue
                num_bytes += media.sizes(start).snapshot_bytes[layer]
                births = range(start + 1, first + 1)
                num_bytes += sum(media.sizes(birth).layer_bytes[layer] for birth in births)
            slices_bytes.append(num_bytes)
            shares = list(accumulate(known, min))
            psnr_db.append(_mixed_db(sizes.gains_db, shares))
        return slices_bytes, psnr_db, (float(num_layers), *known)
