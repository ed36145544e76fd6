"""The policies that ours is compared with, as rules: of the throughput of this moment, BOLA and
RobustMPC, and the paper's own.

Rule: a `Rule` sees one `Situation` and its own state, nothing else, and says how many layers the
next group of slices gets. So the published policies can be written as their papers put them: a
chunk comes, which of its sizes is it to be?

`InOrder` sends by it: slices in order of birth, each complete at once. This is how video is
delivered by chunks: what was sent is never mended, and nothing is sent out of its turn. More layers
begin at a segment's first frame only: the slice of that frame as before, the keyframes of the
layers that are new, and then slices with more layers. Any group may have fewer.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass
from itertools import accumulate
from statistics import fmean, harmonic_mean

from server.abr.decisioncontext import DecisionContext, Send, SendKeyframes, SendSlices
from server.abr.media import Media, segment_start

from .qoe import QoeConfig


@dataclass(frozen=True, slots=True)
class Group:
    """A run of slices that get the same layers; the tuples have one entry for each layer count."""

    media_s: float
    """Seconds of media that show because of it; 0 of what only leads to the first frame."""
    slice_bytes: tuple[float, ...]
    """Bytes of its slices with 1, 2, ... layers; rising."""
    psnr_db: tuple[float, ...]
    """Mean PSNR with 1, 2, ... layers, dB (index.bin); rising."""
    keyframe_bytes: tuple[float, ...]
    """Bytes of the keyframes of 1, 2, ... layers at its first frame."""
    can_rise: bool
    """Whether it may get more layers than the group before it."""

    def lost_db(self, layers: int) -> float:
        """What `layers` layers lack of the PSNR of all, dB."""
        return self.psnr_db[-1] - self.psnr_db[layers - 1]

    def most_layers(self, held: int) -> int:
        """The most layers that it may get behind a group with `held`."""
        return len(self.slice_bytes) if self.can_rise else max(held, 1)

    def rise_bytes(self, num_layers: int, held: int) -> float:
        """Bytes of the keyframes that raise its first frame from `held` layers to `num_layers`."""
        before = self.keyframe_bytes[held - 1] if held else 0.0
        return self.keyframe_bytes[num_layers - 1] - before if num_layers > held else 0.0

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
        """Whether the keyframes with which it rises may still have to be sent."""

    def choose(self, context: DecisionContext) -> Send | None:
        media, holding = context.media, context.holding
        birth = holding.end_birth(0)
        if birth is None:
            first = segment_start(media, context.clock.first_frame)
            if first >= context.end_birth:
                return None
            self._decide(context, first, held=0)
            return SendKeyframes(first, 0, self._layers)
        layers = range(media.num_layers)
        held = next((n for n in layers if holding.end_birth(n) != birth), len(layers))
        if self._rises and held < self._layers:
            return SendKeyframes(birth - 1, held, self._layers)
        self._rises = False
        if birth >= context.end_birth:
            return None
        if birth >= self._end:
            self._decide(context, birth, held)
        if self._layers > held:
            # The first slice of a group that rises; the keyframes follow.
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
        keyframe_bytes=tuple(accumulate(sizes[0].keyframe_bytes)),
        can_rise=begin % media.segment_frames == 0,
    )


SAFETY = 0.9
"""Share of the estimated rate that is planned with (dash.js, Sabre)."""
RISE_S = 4.0
"""Seconds over which the keyframes that a rise takes are spread (ours)."""


class ThroughputRule(Rule):
    """The most layers that the link carries, with something kept back.

    Where dash.js takes the less of two moving averages with half lives of 3 s and 8 s, this goes by
    the estimate as it is. The session's looks back 0.4 s already, decisions are ten times as
    frequent, and with a lead of 6 s every second of delay in reacting costs more than a wrong step.
    """

    def choose_layers(self, situation: Situation) -> int:
        if not situation.measured:
            return 1
        rate_bps = SAFETY * situation.rate_bps
        counts = range(situation.most_layers, 1, -1)
        return next((n for n in counts if situation.need_bps(n, RISE_S) <= rate_bps), 1)


class TailDropRule(Rule):
    """The paper SwinGS's own (section 5.5), slice by slice: the least opaque Gaussians are dropped
    to fit the rate.

    All layers are sent as long as the link carries them; else the tail of each slice is left out. A
    layer is all or nothing, and after it is left out once it is gone until the next segment. The
    paper's demonstration knows the rate and fits all of it; here it is what was measured, and
    SAFETY of it, or there would never be a lead.
    """

    group_s = 0.0

    def choose_layers(self, situation: Situation) -> int:
        if not situation.measured:
            return 1
        group = situation.group
        budget_bytes = SAFETY * situation.rate_bps * group.media_s / 8
        counts = range(situation.most_layers, 1, -1)
        return next((n for n in counts if group.slice_bytes[n - 1] <= budget_bytes), 1)


LOW_LEAD = 0.25
"""Share of the greatest lead up to which layer 0 is sent alone (paper: Q_low, 10 of 30 s)."""
HIGH_LEAD = 0.9
"""Share at which all layers are sent in any case (paper: Q_max, a chunk less than all)."""
ENOUGH_S = 1.0
"""Seconds of lead with which the start is over (BOLA-E: one chunk)."""
MOST_WAIT = 0.7
"""Share of the lead that a group may take to come (dash.js: insufficient buffer, 0.5 to 0.9)."""
TIE_S = 1e-3
"""Seconds of lead beyond where two numbers of layers are worth the same."""


@dataclass(frozen=True, slots=True)
class Lyapunov:
    """The rule of BOLA, by which the lead alone says how many layers (Spiteri, Urgaonkar,
    Sitaraman).

    Of each number of layers m it looks at what a byte of it is worth,

        (V * (v_m + g) - lead) / S_m

    with S_m the bytes of the group, v_m its utility and g what it is worth to play on at all, and
    takes the best. The less lead, the more counts that S_m is small. Utilities are dB over layer 0
    of the index, where the paper takes logarithms of bit rates. V and g follow from two leads:
    where more than layer 0 begins, and up to which it pays to send all layers.
    """

    v_s_per_db: float
    """V: seconds of lead that a dB is worth."""
    g_db: float
    """g (the paper's gamma * p): what playing on is worth, dB."""
    sizes: tuple[float, ...]
    """S_m of 1, 2, ... layers, bytes."""
    utilities_db: tuple[float, ...]
    """v_m of 1, 2, ... layers; 0 for layer 0 alone."""

    @staticmethod
    def between(low_s: float, high_s: float, group: Group, held: int, rise: float) -> Lyapunov:
        """The rule that leaves layer 0 at a lead of low_s and wants nothing more at high_s.

        rise: share of what it takes to rise that is counted, as the group is not the only one that
        has the layers.
        """
        counted = (
            max(1.0, size) + rise * group.rise_bytes(n, held)
            for n, size in enumerate(group.slice_bytes, 1)
        )
        sizes = tuple(accumulate(counted, lambda before, size: max(size, before + 1.0)))
        utilities_db = tuple(psnr_db - group.psnr_db[0] for psnr_db in group.psnr_db)
        # m is better than 1 where the lead is over V * (g - S_1 * v_m / (S_m - S_1)).
        first_db = max(
            (
                sizes[0] * v / (size - sizes[0])
                for size, v in zip(sizes[1:], utilities_db[1:], strict=True)
            ),
            default=0.0,
        )
        v_s_per_db = (high_s - low_s) / max(utilities_db[-1] + first_db, 1e-9)
        return Lyapunov(v_s_per_db, low_s / v_s_per_db + first_db, sizes, utilities_db)

    def best(self, lead_s: float) -> int:
        """The number of layers that is worth most per byte; the fewer of two that are equal."""
        best, layers = -math.inf, 1
        for n, (size, utility_db) in enumerate(zip(self.sizes, self.utilities_db, strict=True), 1):
            worth = (self.v_s_per_db * (utility_db + self.g_db) - lead_s) / size
            if worth > best:
                best, layers = worth, n
        return layers

    def least_lead_s(self, num_layers: int) -> float:
        """The least lead at which it chooses `num_layers` or more."""
        sizes, values = self.sizes, [v + self.g_db for v in self.utilities_db]
        # Each fewer layers must have become worse than the best of those that are enough.
        leads = [
            min(
                self.v_s_per_db
                * (sizes[m] * values[n] - sizes[n] * values[m])
                / (sizes[m] - sizes[n])
                for m in range(num_layers - 1, len(sizes))
            )
            for n in range(num_layers - 1)
        ]
        return max(leads, default=0.0)


class BolaRule(Rule):
    """BOLA with what BOLA-E adds.

    As the paper has it the rule creeps at the start and follows every lead upwards. BOLA-E mends
    both, and so does this: until there is a lead the throughput rule decides, its choice is made
    good for by seconds that are added to the lead, and are used up as the real one grows; it never
    climbs above what the link carries; and no group may take longer to come than a share of the
    lead.
    """

    def __init__(self) -> None:
        self._throughput = ThroughputRule()
        self._starting = True
        self._added_s = 0.0
        """Seconds that are added to the lead (BOLA-E: the placeholder)."""

    def choose_layers(self, situation: Situation) -> int:
        group, lead_s, held = situation.group, situation.lead_s, situation.held
        carried = self._throughput.choose_layers(situation)
        low_s, high_s = LOW_LEAD * situation.max_lead_s, HIGH_LEAD * situation.max_lead_s
        rule = Lyapunov.between(low_s, high_s, group, held, group.media_s / RISE_S)
        if self._starting:
            self._starting = lead_s < ENOUGH_S
            self._added_s = max(0.0, rule.least_lead_s(carried) + TIE_S - lead_s)
            return carried
        self._added_s = min(self._added_s, max(0.0, situation.max_lead_s - lead_s))
        layers = rule.best(lead_s + self._added_s)
        if layers > max(carried, held):
            layers = max(carried, held)
            too_much_s = lead_s + self._added_s - rule.least_lead_s(layers) - TIE_S
            self._added_s = max(0.0, self._added_s - max(0.0, too_much_s))
        # At most as many layers as come while the lead lasts.
        layers = min(layers, situation.most_layers)
        most_bytes = MOST_WAIT * lead_s * situation.rate_bps / 8
        while layers > 1 and group.cost_bytes(layers, held) > most_bytes:
            layers -= 1
        return layers


PAST = 5
"""Groups of which the rates and errors count (paper: 5)."""


@dataclass(frozen=True, slots=True)
class _Plan:
    """The groups of a plan so far."""

    first: int
    """Layers of its first group."""
    lead_s: float
    worth: float
    """dB times seconds."""


class RobustMpcRule(Rule):
    """RobustMPC: plans groups ahead against a rate that is promised to be low (Yin et al., 2015).

    The rate is the harmonic mean of the last ones, over 1 + the greatest error that this very
    prediction had made of late. Of all plans for the next groups the one is best that maximises the
    sum of

        quality - stall_db * seconds of stall - switch_db * steps between groups

    with the weights of qoe.py, and its first group is sent. The paper plans 5 chunks of 4 s for a
    buffer of 30 s; this plans 5 groups of 1 s for a lead of 6 s.

    All plans are a tree; two of them that end with the same layers differ only in the lead and the
    worth so far, and one that has less of both is never better. So few are kept.
    """

    horizon = 5
    group_s = 1.0  # as much of the lead is planned as in the paper

    def __init__(self) -> None:
        self._rates_bps: deque[float] = deque(maxlen=PAST)
        self._errors: deque[float] = deque(maxlen=PAST)
        self._predicted_bps: float | None = None
        self._lost_db: float | None = None

    def choose_layers(self, situation: Situation) -> int:
        layers = 1
        if situation.measured:
            rate_bps = self._rate_bps(situation)
            layers = best_plan(situation, rate_bps, self._lost_db, QoeConfig())
        self._lost_db = situation.group.lost_db(layers)
        return layers

    def _rate_bps(self, situation: Situation) -> float:
        """Takes in the rate of now, and says what to plan with."""
        rate_bps = situation.rate_bps
        if self._predicted_bps is not None:
            self._errors.append(abs(self._predicted_bps - rate_bps) / rate_bps)
        self._rates_bps.append(rate_bps)
        self._predicted_bps = harmonic_mean(self._rates_bps)
        return self._predicted_bps / (1 + max(self._errors, default=0.0))


def best_plan(situation: Situation, rate_bps: float, lost_db: float | None, qoe: QoeConfig) -> int:
    """The layers of the first group of the best plan; of equal ones the fewest.

    lost_db: what the group before lacks of all layers, dB; None at the beginning.
    """
    # Of each number of layers that a plan may end with, those plans that may still be best.
    plans: dict[int, list[_Plan]] = {situation.held: [_Plan(0, situation.lead_s, 0.0)]}
    for number, group in enumerate(situation.coming):
        before = situation.coming[number - 1] if number else None
        longer: dict[int, list[_Plan]] = {}
        for held, kept in plans.items():
            lost_before_db = before.lost_db(held) if before else lost_db
            for layers in range(1, group.most_layers(held) + 1):
                step_db = 0.0
                if lost_before_db is not None:
                    step_db = abs(group.lost_db(layers) - lost_before_db)
                worth = group.psnr_db[layers - 1] * group.media_s
                worth -= qoe.switch_db * qoe.stretch_s * step_db
                takes_s = 8 * group.cost_bytes(layers, held) / rate_bps
                longer.setdefault(layers, []).extend(
                    _Plan(
                        plan.first or layers,
                        min(situation.max_lead_s, max(0.0, plan.lead_s - takes_s) + group.media_s),
                        plan.worth + worth - qoe.stall_db * max(0.0, takes_s - plan.lead_s),
                    )
                    for plan in kept
                )
        plans = {layers: _undominated(found) for layers, found in longer.items()}
    found = [plan for kept in plans.values() for plan in kept]
    return max(found, key=lambda plan: (plan.worth, -plan.first)).first


def _undominated(plans: list[_Plan]) -> list[_Plan]:
    """The plans that no other plan surpasses in both lead and worth."""
    plans.sort(key=lambda plan: (-plan.worth, -plan.lead_s, plan.first))
    kept, longest_s = [], -1.0
    for plan in plans:
        if plan.lead_s > longest_s:
            kept.append(plan)
            longest_s = plan.lead_s
    return kept
