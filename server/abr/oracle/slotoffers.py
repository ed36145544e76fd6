"""What bytes buy where slots last (format version 2).

A change renews a share of its layer, and what is not renewed wears away by that share from each
frame to the next. So a layer is known in frame f to no more than

    known(f) = (1 - changed(f)) * known(f - 1) + changed(f) * [its change is there],

and a snapshot adds 1. Summed up, a change of frame b is worth changed(b) * (1 + left(b)) frames,
where left(b) are the frames that what is known at b is still known for, worn as it is; changes
that all come are worth a frame each. A holding asks for more: that no change before is missing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..media import segment_start
from .feasible import Play
from .groups import Group
from .offers import LEAST_BYTES, Offer, Offers, packet_bytes


def slot_offers(play: Play, groups: tuple[Group, ...]) -> Offers:
    """Version 2."""
    worths = [_worth(play, layer) for layer in range(1, play.media.num_layers)]
    offers = [
        offer
        for layer, worth in enumerate(worths, 1)
        for number in range(len(groups))
        for offer in _group_offers(play, groups[number], number, layer, worth)
    ]
    stores = [tuple(worth.left[group.end_frame - 1] for group in groups) for worth in worths]
    spare_bytes = sum(worth.spare_bytes for worth in worths)
    return Offers(tuple(offers), tuple(stores), True, spare_bytes)


@dataclass(frozen=True, slots=True)
class _Worth:
    """What the packets of one layer are worth; one entry for each frame from 0 on."""

    left: list[float]
    """Frames after this one for which what is known now is still known."""
    own: list[float]
    """Frames for each byte of its change."""
    late: list[float]
    """Frames for each byte of the best change before, if it comes only now."""
    num_bytes: list[float]
    """Of its change."""
    snapshot_bytes: list[float]
    """Of the smallest snapshot so far."""
    snapshot: list[float]
    """Frames for each byte of the best snapshot so far, if it comes now."""
    spare_bytes: float


def _worth(play: Play, layer: int) -> _Worth:
    media, until = play.media, play.until_frame
    every = [media.sizes(birth) for birth in range(until)]
    changed = [sizes.changed_shares[layer] for sizes in every]
    num_bytes = [packet_bytes(sizes, layer) for sizes in every]
    spare_bytes = sum(num_bytes) - sum(sizes.layer_bytes[layer] for sizes in every)
    left = [0.0] * until
    for frame in range(until - 1, 0, -1):
        left[frame - 1] = (1 - changed[frame]) * (1 + left[frame])
    own = [c * (1 + more) / size for c, more, size in zip(changed, left, num_bytes, strict=True)]
    late, snapshot, snapshot_bytes = [0.0] * until, [0.0] * until, [0.0] * until
    change_share, snapshot_share, least_bytes = 0.0, 0.0, math.inf  # shares for each byte, worn
    for frame in range(until):
        change_share *= 1 - changed[frame]
        snapshot_share *= 1 - changed[frame]
        late[frame] = change_share * (1 + left[frame])
        change_share = max(change_share, changed[frame] / num_bytes[frame])
        if frame % media.segment_frames == 0:
            whole_bytes = max(LEAST_BYTES, every[frame].snapshot_bytes[layer])
            spare_bytes += whole_bytes - every[frame].snapshot_bytes[layer]
            least_bytes = min(least_bytes, whole_bytes)
            snapshot_share = max(snapshot_share, 1 / whole_bytes)
        snapshot_bytes[frame] = least_bytes
        snapshot[frame] = snapshot_share * (1 + left[frame])
    return _Worth(left, own, late, num_bytes, snapshot_bytes, snapshot, spare_bytes)


def _group_offers(play: Play, group: Group, number: int, layer: int, worth: _Worth) -> list[Offer]:
    start, frames = group.first_frame, range(group.first_frame, group.end_frame)
    best, late = max(worth.own[frame] for frame in frames), worth.late[start]
    births = frames
    if not number:
        # Nothing comes late for the first group: the changes before it are its own.
        births = range(segment_start(play.media, start), group.end_frame)
        best = max(best, late)
    num_bytes = sum(worth.num_bytes[birth] for birth in births)
    offers = [Offer(layer, number, num_bytes, best * num_bytes, whole=True)]
    # Where late ones are worth less, those of the group stand for them.
    if late > best:
        offers.append(Offer(layer, number, num_bytes, late * num_bytes))
    num_bytes = max(LEAST_BYTES, group.sizes.snapshot_bytes[layer])
    most = max(worth.snapshot[frame] for frame in frames)
    begins = num_bytes / worth.snapshot_bytes[group.end_frame - 1]
    offers.append(Offer(layer, number, num_bytes, most * num_bytes, begins))
    return offers
