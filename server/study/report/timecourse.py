"""One play over time: the link, what was known of it, and what the client held and showed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from server.abr.holding import Holding
from server.abr.link.link import Link
from server.study.cases import Case
from server.study.looped import LoopedMedia
from server.study.plays import Outcome, Play, Rules, run_play
from server.study.simulate.simulator import Arrival, Shown

from .summary import OWN

ESTIMATE_S = 0.1
"""One estimate is kept in such a time."""

Points = tuple[tuple[float, float], ...]
"""(seconds, value), in order of time."""


@dataclass(frozen=True, slots=True)
class TimeLine:
    """The course of a play over time, up to the last frame."""

    case: Case
    policy: str
    link_bps: Points
    """From each time on."""
    estimate_bps: Points
    layers: Points
    """As each frame showed."""
    lead_s: Points
    """Seconds of media that the client held beyond the shown frame: its buffer."""
    stalls_s: tuple[tuple[float, float], ...]
    """(begin, end) of the wait for the first frame and of each stall."""


def follow(media: LoopedMedia, case: Case, policy: str, rules: Rules) -> TimeLine:
    """Plays once more, and takes notes."""
    result, shown, _ = run_play(media, case, policy, rules, keep_estimates=True)
    end_s = shown[-1].shown_s + 1 / media.fps
    estimates = {
        math.floor(time_s / ESTIMATE_S): (time_s, rate_bps)
        for time_s, rate_bps, _ in result.estimates
        if rate_bps
    }
    return TimeLine(
        case=case,
        policy=policy,
        link_bps=tuple(_link_bps(case.link, end_s)),
        estimate_bps=tuple(estimates.values()),
        layers=tuple((one.shown_s, one.layers) for one in shown),
        lead_s=tuple(_leads_s(media, result.arrivals, shown)),
        stalls_s=tuple(_stalls_s(media, shown)),
    )


def _link_bps(link: Link, end_s: float) -> Iterator[tuple[float, float]]:
    time_s = 0.0
    while True:
        for step in link.steps:
            yield time_s, step.rate_bps
            time_s += step.duration_s
            if time_s >= end_s:
                return


def _leads_s(
    media: LoopedMedia, arrivals: Sequence[Arrival], shown: Sequence[Shown]
) -> Iterator[tuple[float, float]]:
    """The lead as each frame shows, that frame included."""
    holding, n = Holding(media, 0), 0
    for one in shown:
        while n < len(arrivals) and arrivals[n].time_s <= one.shown_s + 1e-9:
            arrivals[n].what.add_to(holding)
            n += 1
        yield one.shown_s, (holding.end_frame - one.frame) / media.fps
        holding.forget(one.frame)


def _stalls_s(media: LoopedMedia, shown: Sequence[Shown]) -> Iterator[tuple[float, float]]:
    yield 0.0, shown[0].shown_s
    for one in shown:
        if one.shown_s > one.due_s + 1e-9:
            yield one.due_s, one.shown_s


def telling_outcome(outcomes: Sequence[Outcome], policy: str) -> Outcome:
    """The default case to show: at the median load, the one with the median normalised QoE of
    `policy`."""
    loads = sorted({outcome.load for outcome in outcomes})
    load = loads[(len(loads) - 1) // 2]

    def rank(outcome: Outcome) -> tuple[float, str]:
        place = play_of(outcome, policy).normalised
        return (-math.inf if math.isnan(place) else place, outcome.trace)

    ordered = sorted((outcome for outcome in outcomes if outcome.load == load), key=rank)
    return ordered[(len(ordered) - 1) // 2]


def play_of(outcome: Outcome, policy: str) -> Play:
    return next(play for play in outcome.plays if play.policy == policy)


def telling_policies(outcome: Outcome) -> list[str]:
    """Ours, if it plays, and the best of the others in this case."""
    others = [play for play in outcome.plays if play.policy != OWN]
    best = sorted(others, key=lambda play: -play.quality_db)[:1]
    own = [play for play in outcome.plays if play.policy == OWN]
    return [play.policy for play in (*own, *best)]
