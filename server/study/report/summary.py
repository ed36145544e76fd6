"""Summary of many plays: means of each policy at each load, and the lead of ours."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean

from server.study.plays import Oracle, Outcome, Play

from .bootstrap import Interval, mean_interval

OWN = "sweep"
"""Ours, which the others are compared with."""


@dataclass(frozen=True, slots=True)
class PolicySummary:
    """A policy at a load, as means over the traces."""

    policy: str
    quality_db: float
    normalised: float
    """See `normalised_mean`."""
    psnr_db: float
    low_psnr_db: float
    rebuffering: float
    startup_s: float
    stalls: float
    step_db: float
    layers: float
    wasted: float
    """Share of the bytes of all plays together."""
    behind: Interval | None
    """QoE of ours less that of this one in the same case, dB; None of ours, or without it."""


@dataclass(frozen=True, slots=True)
class LoadSummary:
    """All policies at one load, or over all of them."""

    load: float | None
    """None for all loads together."""
    plays: int
    """Number of plays of each policy."""
    bound_db: float
    base_db: float
    bound_psnr_db: float
    base_rebuffering: float
    base_startup_s: float
    standings: tuple[PolicySummary, ...]


def normalised_mean(plays: Sequence[Play], oracles: Sequence[Oracle]) -> float:
    """Normalised QoE of several plays: where their mean lies between two others.

        (mean QoE - mean QoE of layer 0 alone) / (mean bound - mean QoE of layer 0 alone)

    Both are those of `oracle.bound`; so 0 needs no choice at all, and no policy exceeds 1. It is a
    ratio of means and not the mean of the plays' ratios: the ratio of a play with almost nothing to
    gain is meaningless, and in a ratio of means such plays have almost no weight. NaN if there is
    nothing to gain at all.
    """
    base_db = fmean(oracle.base_db for oracle in oracles)
    room_db = fmean(oracle.quality_db for oracle in oracles) - base_db
    gained_db = fmean(play.quality_db for play in plays) - base_db
    return gained_db / room_db if room_db > 0 else math.nan


def summarise(outcomes: Sequence[Outcome], seed: int) -> list[LoadSummary]:
    """At each load, in the order in which they come, and then over all loads if there are more."""
    loads = list(dict.fromkeys(outcome.load for outcome in outcomes))
    summaries = [
        _summary(load, [outcome for outcome in outcomes if outcome.load == load], seed)
        for load in loads
    ]
    return summaries + ([_summary(None, outcomes, seed)] if len(loads) > 1 else [])


def _summary(load: float | None, outcomes: Sequence[Outcome], seed: int) -> LoadSummary:
    oracles = [outcome.oracle for outcome in outcomes]
    policies = [play.policy for play in outcomes[0].plays]
    return LoadSummary(
        load=load,
        plays=len(outcomes),
        bound_db=fmean(oracle.quality_db for oracle in oracles),
        base_db=fmean(oracle.base_db for oracle in oracles),
        bound_psnr_db=fmean(oracle.psnr_db for oracle in oracles),
        base_rebuffering=fmean(oracle.rebuffering for oracle in oracles),
        base_startup_s=fmean(oracle.startup_s for oracle in oracles),
        standings=tuple(
            _standing(number, policy, outcomes, oracles, _behind(number, policies, outcomes, seed))
            for number, policy in enumerate(policies)
        ),
    )


def _standing(
    number: int,
    policy: str,
    outcomes: Sequence[Outcome],
    oracles: Sequence[Oracle],
    behind: Interval | None,
) -> PolicySummary:
    plays = [outcome.plays[number] for outcome in outcomes]

    def mean(value: Callable[[Play], float]) -> float:
        return fmean(map(value, plays))

    came_bytes = math.fsum(play.came_bytes for play in plays)
    wasted_bytes = math.fsum(play.wasted * play.came_bytes for play in plays)
    return PolicySummary(
        policy=policy,
        quality_db=mean(lambda play: play.quality_db),
        normalised=normalised_mean(plays, oracles),
        psnr_db=mean(lambda play: play.psnr_db),
        low_psnr_db=mean(lambda play: play.low_psnr_db),
        rebuffering=mean(lambda play: play.rebuffering),
        startup_s=mean(lambda play: play.startup_s),
        stalls=mean(lambda play: play.stalls),
        step_db=mean(lambda play: play.step_db),
        layers=mean(lambda play: play.layers),
        wasted=wasted_bytes / came_bytes if came_bytes else 0.0,
        behind=behind,
    )


def _behind(
    number: int, policies: Sequence[str], outcomes: Sequence[Outcome], seed: int
) -> Interval | None:
    """How far ours is ahead of policy `number`, trace by trace: the loads of one trace are not
    independent draws, so their mean counts as one."""
    if OWN not in policies or policies[number] == OWN:
        return None
    own = policies.index(OWN)
    by_trace: dict[str, list[float]] = {}
    for outcome in outcomes:
        ahead_db = outcome.plays[own].quality_db - outcome.plays[number].quality_db
        by_trace.setdefault(outcome.trace, []).append(ahead_db)
    return mean_interval([fmean(differences) for differences in by_trace.values()], seed)
