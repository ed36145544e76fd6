"""Rules: a policy that says how many layers the next group of slices gets.

Rule: a `Rule` sees one `Situation` and its own state, nothing else. So the published policies can
be written as their papers put them: a chunk comes, which of its sizes is it to be?

`InOrder` sends by it: slices in order of birth, each complete at once. This is how video is
delivered by chunks: what was sent is never mended, and nothing is sent out of its turn. More layers
begin at a segment's first frame only: the slice of that frame as before, the snapshots of the
layers that are new, and then slices with more layers. Any group may have fewer.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import accumulate
from statistics import fmean

from server.abr.decisioncontext import DecisionContext, Send, SendSlices, SendSnapshots
from server.abr.media import Media, segment_start


@dataclass(frozen=True, slots=True)
class Group:
    """A run of slices that get the same layers; the tuples have one entry for each layer count."""

    media_s: float
    """Seconds of media that show because of it; 0 of what only leads to the first frame."""
    slice_bytes: tuple[float, ...]
    """Bytes of its slices with 1, 2, ... layers; rising."""
    psnr_db: tuple[float, ...]
    """Mean PSNR with 1, 2, ... layers, dB (index.bin); rising."""
    snapshot_bytes: tuple[float, ...]
    """Bytes of the snapshots of 1, 2, ... layers at its first frame."""
    can_rise: bool
    """Whether it may get more layers than the group before it."""

    def lost_db(self, layers: int) -> float:
        """What `layers` layers lack of the PSNR of all, dB."""
        return self.psnr_db[-1] - self.psnr_db[layers - 1]

    def most_layers(self, held: int) -> int:
        """The most layers that it may get behind a group with `held`."""
        return len(self.slice_bytes) if self.can_rise else max(held, 1)

    def rise_bytes(self, num_layers: int, held: int) -> float:
        """Bytes of the snapshots that raise its first frame from `held` layers to `num_layers`."""
        before = self.snapshot_bytes[held - 1] if held else 0.0
        return self.snapshot_bytes[num_layers - 1] - before if num_layers > held else 0.0

    def cost_bytes(self, num_layers: int, held: int) -> float:
        """All that it takes with `num_layers` behind a group with `held`."""
        return self.slice_bytes[num_layers - 1] + self.rise_bytes(num_layers, held)


@dataclass(frozen=True, slots=True)
class Situation:
    """The state of a play when the layers of the next group must be chosen."""

    now_s: float
    """On the clock of the session."""
    rate_bps: float
    """Estimated throughput of the last moments, bits per second; a guess until there is one."""
    measured: bool
    """Whether rate_bps is an estimate."""
    lead_s: float
    """Seconds of media that the client holds beyond what it shows when the group begins to come;
    the papers' buffer level."""
    max_lead_s: float
    """The most lead that can be had now; less than the session's where a live stream ends."""
    held: int
    """Layers of the group before; 0 at the beginning."""
    coming: tuple[Group, ...]
    """The group in question and those behind it, as many as the rule asks for or as there are."""

    @property
    def group(self) -> Group:
        return self.coming[0]

    @property
    def most_layers(self) -> int:
        return self.group.most_layers(self.held)

    def need_bps(self, num_layers: int, rise_s: float) -> float:
        """Rate at which the group is sent in the time that it is shown; the bytes of a rise are
        spread over `rise_s` seconds."""
        group = self.group
        if not group.media_s:
            return math.inf
        rise_bps = 8 * group.rise_bytes(num_layers, self.held) / rise_s
        return 8 * group.slice_bytes[num_layers - 1] / group.media_s + rise_bps


class Rule(ABC):
    """Chooses layers for one client, group after group."""

    horizon: int = 1
    """How many groups it wants to see, at least 1."""
    group_s: float = 0.5
    """Seconds of media that are decided for at once; at least a frame. The papers' chunks are 2 to
    4 s of a lead of 30 s, this is as much of one of 6 s."""

    @abstractmethod
    def choose_layers(self, situation: Situation) -> int:
        """How many layers, 1 to situation.most_layers, the group gets."""


class InOrder:
    """The policy that a rule makes."""

    mends = False

    def __init__(self, rule: Rule) -> None:
        self._rule = rule
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
        self._end = group_end(context.media, birth, self._rule.group_s)
        self._rises = self._layers > held

    def _situation(self, context: DecisionContext, birth: int, held: int) -> Situation:
        media, clock = context.media, context.clock
        until = clock.until_frame
        coming: list[Group] = []
        begin = birth
        while len(coming) < max(1, self._rule.horizon) and (until is None or begin < until):
            end = group_end(media, begin, self._rule.group_s)
            end = end if until is None else min(end, until)
            coming.append(group_of(media, begin, end, clock.first_frame))
            begin = end
        max_lead_s = context.max_lead_s
        if media.live:  # at the edge nothing more can be had, for now
            left = max(1, media.num_frames - context.next_frame)
            max_lead_s = min(max_lead_s, left / media.fps)
        return Situation(
            now_s=context.now_s,
            rate_bps=context.rate_bps,
            measured=context.measured,
            lead_s=max(0.0, context.due_s(birth) - context.comes_s(0.0, context.rate_bps)),
            max_lead_s=max_lead_s,
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
