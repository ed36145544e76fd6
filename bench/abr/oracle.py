"""The two ends that a case is judged between: a bound that no policy exceeds, and layer 0 alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bench.abr.bound import base_only, bound
from server.study.config import Rules
from server.study.looped import LoopedMedia
from server.study.study import DB_DIGITS, DIGITS, Case, Play, score_plays


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

    oracle: Oracle
    plays: tuple[Play, ...]


def judge(media: LoopedMedia, case: Case, rules: Rules) -> Oracle:
    """The bound and the base line of `case`."""
    span = 0, media.num_frames
    best = bound(media, case.link, rules.session, rules.qoe, *span)
    base = base_only(media, case.link, rules.session, rules.qoe, *span)
    return Oracle(
        quality_db=round(best.quality_db, DB_DIGITS),
        psnr_db=round(best.psnr_db, DB_DIGITS),
        base_db=round(base.quality_db, DB_DIGITS),
        rebuffering=round(max(0.0, base.stalled_s) / media.length_s, DIGITS),
        startup_s=round(base.startup_s, DIGITS),
    )


def judge_plays(media: LoopedMedia, rules: Rules, policies: Sequence[str], case: Case) -> Outcome:
    """All `policies` in `case`."""
    oracle = judge(media, case, rules)
    return Outcome(oracle, tuple(score_plays(media, rules, policies, case)))
