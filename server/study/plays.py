"""One case: every policy plays it, and the oracle says what could have been had.

Rule: what is kept is rounded to what means something, so that the last digits of a solver or a
processor are in no report.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import fmean

from codec.errors import InvalidError
from server.abr.playout import PlayoutClock
from server.abr.session import SessionConfig
from server.study.oracle.bound import base_only, bound, normalised
from server.study.policies.choice import POLICIES
from server.study.simulate.qoe import QoeConfig, score
from server.study.simulate.simulator import Shown, Simulated, play_out, simulate
from server.study.simulate.waste import measure_traffic

from .cases import Case
from .looped import LoopedMedia

MOST_S = 20_000.0
"""Virtual seconds after which a play that has not ended never will."""
_DB_DIGITS, _DIGITS = 4, 6


@dataclass(frozen=True, slots=True)
class Rules:
    """Settings shared by all plays."""

    session: SessionConfig = field(default_factory=SessionConfig)
    qoe: QoeConfig = field(default_factory=QoeConfig)


@dataclass(frozen=True, slots=True)
class Play:
    """How one policy did in one case."""

    policy: str
    quality_db: float
    """QoE, server/abr/qoe.py."""
    normalised: float
    """0 for layer 0 alone, 1 for the oracle's bound, see `oracle.bound.normalised`; NaN where
    the two are the same."""
    psnr_db: float
    """Mean over the frames."""
    low_psnr_db: float
    """5th percentile of the frames."""
    rebuffering: float
    """Seconds of stalls for each second shown; without the start."""
    startup_s: float
    stalls: int
    step_db: float
    """Mean step between stretches of half a second, of the PSNR lost against all layers: how much
    it switches."""
    layers: float
    """Mean over the frames; a part of a layer counts as that part."""
    came_bytes: float
    wasted: float
    """Share of came_bytes that no frame showed, waste.py."""


@dataclass(frozen=True, slots=True)
class Oracle:
    """The bound and the base line of one case."""

    quality_db: float
    """No play is worth more."""
    psnr_db: float
    """Mean PSNR of the solution that the bound is of."""
    base_db: float
    """Quality of layer 0 alone, sent as early as possible."""
    rebuffering: float
    """Seconds of stalls per second shown, with layer 0 alone; its total waiting is the least
    possible."""
    startup_s: float
    """Seconds until the first frame, with layer 0 alone."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """The results of a case."""

    trace: str
    load: float
    oracle: Oracle
    plays: tuple[Play, ...]


def run_play(
    media: LoopedMedia, case: Case, policy: str, rules: Rules, keep_estimates: bool = False
) -> tuple[Simulated, list[Shown], PlayoutClock]:
    """A whole play. Raises InvalidError where it does not end."""
    result = simulate(
        media,
        POLICIES[policy](media),
        case.link,
        rules.session,
        at_most_s=MOST_S,
        keep_estimates=keep_estimates,
    )
    shown, clock = play_out(media, result, rules.session, 0, media.num_frames)
    if len(shown) < media.num_frames:
        raise InvalidError(
            f"trace {case.trace} at load {case.load:g}: {policy} has shown {len(shown)} of "
            f"{media.num_frames} frames after {MOST_S:g} s; leave the trace out or raise the load"
        )
    return result, shown, clock


def judge(media: LoopedMedia, case: Case, rules: Rules) -> Oracle:
    """The bound and the base line of `case`."""
    span = 0, media.num_frames
    best = bound(media, case.link, rules.session, rules.qoe, *span)
    base = base_only(media, case.link, rules.session, rules.qoe, *span)
    return Oracle(
        quality_db=round(best.quality_db, _DB_DIGITS),
        psnr_db=round(best.psnr_db, _DB_DIGITS),
        base_db=round(base.quality_db, _DB_DIGITS),
        rebuffering=round(max(0.0, base.stalled_s) / media.length_s, _DIGITS),
        startup_s=round(base.startup_s, _DIGITS),
    )


def score_play(media: LoopedMedia, case: Case, policy: str, oracle: Oracle, rules: Rules) -> Play:
    """How `policy` does in `case`."""
    result, shown, clock = run_play(media, case, policy, rules)
    started_s = clock.started_s
    assert started_s is not None, "all frames have shown"
    psnr_db = [one.psnr_db for one in shown]
    best_db = media.best_db(range(media.num_frames))
    qoe = score(psnr_db, best_db, media.fps, started_s, clock.stalled_s, clock.stalls, rules.qoe)
    traffic = measure_traffic(media, result.arrivals, shown)
    quality_db = round(qoe.quality_db, _DB_DIGITS)
    place = normalised(quality_db, oracle.base_db, oracle.quality_db)
    return Play(
        policy=policy,
        quality_db=quality_db,
        normalised=place if math.isnan(place) else round(place, _DB_DIGITS),
        psnr_db=round(qoe.psnr_db, _DB_DIGITS),
        low_psnr_db=round(qoe.low_psnr_db, _DB_DIGITS),
        rebuffering=round(qoe.stalled_s / media.length_s, _DIGITS),
        startup_s=round(qoe.startup_s, _DIGITS),
        stalls=qoe.stalls,
        step_db=round(qoe.step_db, _DB_DIGITS),
        layers=round(fmean(one.layers for one in shown), _DB_DIGITS),
        came_bytes=round(traffic.came_bytes),
        wasted=round(traffic.wasted_share, _DIGITS),
    )


def run_case(media: LoopedMedia, case: Case, policies: Sequence[str], rules: Rules) -> Outcome:
    """All `policies` in `case`."""
    oracle = judge(media, case, rules)
    plays = tuple(score_play(media, case, policy, oracle, rules) for policy in policies)
    return Outcome(case.trace, case.load, oracle, plays)
