"""The frames of a layer that bytes can buy: the linear relaxation of a holding.

A byte of a layer shows in some frames, in all `frames` of them. Those that lie in later groups than
its own are in store; a store holds no more than all that can be sent would leave.

A change renews a share of its layer, and what is not renewed wears away by that share from each
frame to the next. So a layer is known in frame f to no more than

    known(f) = (1 - changed(f)) * known(f - 1) + changed(f) * [its change is there],

and a keyframe adds 1. Summed up, a change of frame b is worth changed(b) * (1 + left(b)) frames,
where left(b) are the frames that what is known at b is still known for, worn as it is; changes
that all come are worth a frame each. A holding asks for more: that no change before is missing.

Rule: whatever a holding shows of a layer can be bought here for no more bytes than it took.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from bench.abr.feasible import Play
from codec.errors import InvalidError
from server.abr.media import SegmentSizes, segment_start
from server.study.qoe import QoeConfig

GROUP_S = 0.5
"""Seconds of a group where nothing else is asked for."""
LEAST_BYTES = 1.0
"""Packets are taken to have so many, at least; what that adds the link is given as well."""


@dataclass(frozen=True, slots=True)
class Group:
    """Frames of one segment and of one stretch of qoe.py."""

    first_frame: int
    end_frame: int
    stretch: int | None
    """None behind the last whole stretch."""
    sizes: SegmentSizes
    """Sizes of the births first_frame..end_frame-1."""

    @property
    def num_frames(self) -> int:
        return self.end_frame - self.first_frame


@dataclass(frozen=True, slots=True)
class Grouping:
    """All groups of a play, in order."""

    groups: tuple[Group, ...]
    stretch_frames: int
    num_stretches: int


def group_frames(play: Play, config: QoeConfig, group_s: float = GROUP_S) -> Grouping:
    """Groups of `group_s` or less. Raises InvalidError."""
    if not group_s > 0:
        raise InvalidError(f"group_s is {group_s}; it must be positive")
    media, first, until = play.media, play.first_frame, play.until_frame
    stretch_frames = max(1, round(config.stretch_s * media.fps))
    num_stretches = max(1, play.num_frames // stretch_frames)
    starts = {
        *range(first, until, max(1, round(group_s * media.fps))),
        *range(first, until, stretch_frames),
        *range(segment_start(media, first), until, media.segment_frames),
    }
    bounds = [*sorted(start for start in starts if start >= first), until]
    groups = []
    for start, end in pairwise(bounds):
        stretch = (start - first) // stretch_frames
        place = stretch if stretch < num_stretches else None
        groups.append(Group(start, end, place, media.sizes(start)))
    return Grouping(tuple(groups), stretch_frames, num_stretches)


@dataclass(frozen=True, slots=True)
class Offer:
    """Packets of a layer that come in time for a group."""

    layer: int
    group: int
    num_bytes: float
    """Bytes of one unit: all changes of the group, or one packet of another kind."""
    frames: float
    """Frames of the layer that a unit shows, at most, if it is bought in parts too."""
    begins: float = 0.0
    """Size of a keyframe as a multiple of the smallest one; 0 for other packets."""


@dataclass(frozen=True, slots=True)
class Offers:
    """All that can be bought for a play."""

    offers: tuple[Offer, ...]
    stores: tuple[tuple[float, ...], ...]
    """Maximum frames in store after each group, for each layer but layer 0."""
    spare_bytes: float
    """Bytes that LEAST_BYTES adds to all packets together."""


def packet_bytes(sizes: SegmentSizes, layer: int) -> float:
    """Bytes of a slice's packet, as the offers count them."""
    return max(LEAST_BYTES, sizes.layer_bytes[layer])


def make_offers(play: Play, groups: tuple[Group, ...]) -> Offers:
    """Offers of every group for every layer but layer 0."""
    worths = [_worth(play, layer) for layer in range(1, play.media.num_layers)]
    offers = [
        offer
        for layer, worth in enumerate(worths, 1)
        for number in range(len(groups))
        for offer in _group_offers(play, groups[number], number, layer, worth)
    ]
    stores = [tuple(worth.left[group.end_frame - 1] for group in groups) for worth in worths]
    spare_bytes = sum(worth.spare_bytes for worth in worths)
    return Offers(tuple(offers), tuple(stores), spare_bytes)


@dataclass(frozen=True, slots=True)
class _Worth:
    """Values of the packets of one layer; one entry for each frame from 0 on."""

    left: list[float]
    """Frames after this one for which what is known now is still known."""
    own: list[float]
    """Frames for each byte of its change."""
    late: list[float]
    """Frames for each byte of the best change before, if it comes only now."""
    num_bytes: list[float]
    """Bytes of the frame's change."""
    keyframe_bytes: list[float]
    """Bytes of the smallest keyframe so far."""
    keyframe: list[float]
    """Frames for each byte of the best keyframe so far, if it comes now."""
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
    late, keyframe, keyframe_bytes = [0.0] * until, [0.0] * until, [0.0] * until
    change_share, keyframe_share, least_bytes = 0.0, 0.0, math.inf  # shares for each byte, worn
    for frame in range(until):
        change_share *= 1 - changed[frame]
        keyframe_share *= 1 - changed[frame]
        late[frame] = change_share * (1 + left[frame])
        change_share = max(change_share, changed[frame] / num_bytes[frame])
        if frame % media.segment_frames == 0:
            whole_bytes = max(LEAST_BYTES, every[frame].keyframe_bytes[layer])
            spare_bytes += whole_bytes - every[frame].keyframe_bytes[layer]
            least_bytes = min(least_bytes, whole_bytes)
            keyframe_share = max(keyframe_share, 1 / whole_bytes)
        keyframe_bytes[frame] = least_bytes
        keyframe[frame] = keyframe_share * (1 + left[frame])
    return _Worth(left, own, late, num_bytes, keyframe_bytes, keyframe, spare_bytes)


def _group_offers(play: Play, group: Group, number: int, layer: int, worth: _Worth) -> list[Offer]:
    start, frames = group.first_frame, range(group.first_frame, group.end_frame)
    best, late = max(worth.own[frame] for frame in frames), worth.late[start]
    births = frames
    if not number:
        # Nothing comes late for the first group: the changes before it are its own.
        births = range(segment_start(play.media, start), group.end_frame)
        best = max(best, late)
    num_bytes = sum(worth.num_bytes[birth] for birth in births)
    offers = [Offer(layer, number, num_bytes, best * num_bytes)]
    # Where late ones are worth less, those of the group stand for them.
    if late > best:
        offers.append(Offer(layer, number, num_bytes, late * num_bytes))
    num_bytes = max(LEAST_BYTES, group.sizes.keyframe_bytes[layer])
    most = max(worth.keyframe[frame] for frame in frames)
    begins = num_bytes / worth.keyframe_bytes[group.end_frame - 1]
    offers.append(Offer(layer, number, num_bytes, most * num_bytes, begins))
    return offers
