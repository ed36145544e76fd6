"""What bytes buy where slices are whole (format version 1).

A slice shows in as many frames as a window has, and is as small a part of each: so it is worth a
frame, less what has shown before it comes or would show after the end.
"""

from __future__ import annotations

from .feasible import Play
from .groups import Group
from .offers import Offer, Offers, packet_bytes


def slice_offers(play: Play, groups: tuple[Group, ...]) -> Offers:
    """Version 1."""
    layers = range(1, play.media.num_layers)
    offers = [
        offer
        for layer in layers
        for number in range(len(groups))
        for offer in _slice_offers(play, groups[number], number, layer)
    ]
    stores = tuple(_left_over(play, group.end_frame) for group in groups)
    births = range(play.first_frame - play.media.swin_size + 1, play.until_frame)
    all_sizes = [play.media.sizes(birth) for birth in births]
    spare_bytes = sum(
        packet_bytes(sizes, layer) - sizes.layer_bytes[layer]
        for sizes in all_sizes
        for layer in layers
    )
    return Offers(tuple(offers), (stores,) * len(layers), False, spare_bytes)


def _slice_frames(play: Play, birth: int, from_frame: int) -> float:
    """Frames that a slice is worth which shows from `from_frame` on."""
    swin_size = play.media.swin_size
    left = min(birth + swin_size, play.until_frame) - max(birth, from_frame)
    return max(0, left) / swin_size


def _left_over(play: Play, end_frame: int) -> float:
    """What all slices before `end_frame` are worth from there on."""
    births = range(end_frame - play.media.swin_size + 1, end_frame)
    return sum(_slice_frames(play, birth, end_frame) for birth in births)


def _slice_offers(play: Play, group: Group, number: int, layer: int) -> list[Offer]:
    media, start = play.media, group.first_frame

    def worth(birth: int) -> tuple[float, float]:
        """(frames for each byte, bytes) of a slice that is there from this group on."""
        num_bytes = packet_bytes(media.sizes(birth), layer)
        return _slice_frames(play, birth, start) / num_bytes, num_bytes

    earlier = [worth(birth) for birth in range(start - media.swin_size + 1, start)]
    own = [worth(birth) for birth in range(start, group.end_frame)]
    if not number:
        # Nothing comes late for the first group: the slices before it are its own.
        own, earlier = earlier + own, []
    num_bytes = sum(size for _, size in own)
    best, _ = max(own)
    offers = [Offer(layer, number, num_bytes, best * num_bytes, whole=True)]
    late, late_bytes = max(earlier, default=(0.0, 0.0))
    # Where late ones are worth less, those of the group stand for them.
    if late > best:
        offers.append(Offer(layer, number, late_bytes, late * late_bytes))
    return offers
