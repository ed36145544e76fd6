"""Sends slices in order of birth, each complete at once, with as many layers as a rule says.

This is how video is delivered by chunks: what was sent is never mended, and nothing is sent out of
its turn. The published policies run behind it. More layers begin at a segment's first frame only:
the slice of that frame as before, the snapshots of the layers that are new, and then slices with
more layers. Any group may have fewer.
"""

from __future__ import annotations

from itertools import accumulate
from statistics import fmean

from codec.errors import InvalidError
from server.abr.decisioncontext import DecisionContext, Send, SendSlices, SendSnapshots
from server.abr.media import Media, segment_start

from .situation import Group, Rule, Situation

GROUP_S = 0.5
"""Seconds of media that are decided for at once: the papers' chunks are 2 to 4 s of a lead of 30 s,
this is as much of one of 6 s."""


class InOrder:
    """The policy that a rule makes."""

    mends = False

    def __init__(self, rule: Rule, group_s: float = GROUP_S) -> None:
        if not group_s > 0:
            raise InvalidError(f"group_s is {group_s}; it must be positive")
        self._rule = rule
        self._group_s = group_s
        self._end = 0
        """Where the group ends that was decided for."""
        self._layers = 0
        """Layers of that group."""
        self._rises = False
        """Whether the snapshots with which it rises may still have to be sent."""

    def choose(self, context: DecisionContext) -> Send | None:
        media, holding = context.media, context.holding
        birth = holding.end_birth(0)
        if birth is None:
            first = segment_start(media, context.clock.first_frame)
            if first >= context.end_birth:
                return None
            self._decide(context, first, held=0)
            return SendSnapshots(first, 0, self._layers)
        layers = range(media.num_layers)
        held = next((n for n in layers if holding.end_birth(n) != birth), len(layers))
        if self._rises and held < self._layers:
            return SendSnapshots(birth - 1, held, self._layers)
        self._rises = False
        if birth >= context.end_birth:
            return None
        if birth >= self._end:
            self._decide(context, birth, held)
        if self._layers > held:
            # The first slice of a group that rises; the snapshots follow.
            return SendSlices(range(birth, birth + 1), 0, held)
        size = media.sizes(birth).slice_bytes[self._layers - 1]
        end = birth + context.run_length(size, context.rate_bps)
        return SendSlices(range(birth, min(self._end, context.end_birth, end)), 0, self._layers)

    def _decide(self, context: DecisionContext, birth: int, held: int) -> None:
        """Asks the rule about the group that begins with `birth`."""
        situation = self._situation(context, birth, held)
        most = min(situation.most_layers, context.max_layers)
        self._layers = max(1, min(most, self._rule.choose_layers(situation)))
        self._end = group_end(context.media, birth, self._group_s)
        self._rises = self._layers > held

    def _situation(self, context: DecisionContext, birth: int, held: int) -> Situation:
        media, clock = context.media, context.clock
        until = clock.until_frame
        coming: list[Group] = []
        begin = birth
        while len(coming) < max(1, self._rule.horizon) and (until is None or begin < until):
            end = group_end(media, begin, self._group_s)
            end = end if until is None else min(end, until)
            coming.append(group_of(media, begin, end, clock.first_frame))
            begin = end
        return Situation(
            now_s=context.now_s,
            rate_bps=context.rate_bps,
            measured=context.measured,
            lead_s=max(0.0, context.due_s(birth) - context.comes_s(0.0, context.rate_bps)),
            max_lead_s=min(context.max_lead_s, (media.num_frames - context.next_frame) / media.fps)
            if media.live
            else context.max_lead_s,
            held=held,
            coming=tuple(coming),
        )


def group_end(media: Media, birth: int, group_s: float) -> int:
    """Where the group of `birth` ends: about `group_s` long, and segments begin with a group."""
    frames = max(1, round(group_s * media.fps))
    span = media.segment_frames * max(1, round(frames / media.segment_frames))
    length = -(-span // max(1, round(span / frames)))
    into = birth % span
    return birth - into + min(span, into - into % length + length)


def group_of(media: Media, begin: int, end: int, first_frame: int) -> Group:
    """The slices begin..end-1, seen by a client that plays from `first_frame`."""
    last = media.num_frames - 1  # of a live stream: what comes is taken to be like it
    sizes = [media.sizes(min(birth, last)) for birth in range(begin, end)]
    return Group(
        media_s=max(0, end - max(begin, first_frame)) / media.fps,
        slice_bytes=tuple(map(sum, zip(*(s.slice_bytes for s in sizes), strict=True))),
        psnr_db=tuple(map(fmean, zip(*(s.psnr_db for s in sizes), strict=True))),
        snapshot_bytes=tuple(accumulate(sizes[0].snapshot_bytes)),
        can_rise=begin % media.segment_frames == 0,
    )
