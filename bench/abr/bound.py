"""An upper bound on a link for all policies, even for those that know the whole link beforehand.

For plays that wait between a and b seconds in total, a linear programme in which every packet is
due as late as b seconds of waiting allow bounds PSNR and steps, and a bounds the cost of waiting.
The bound is the largest over all such spans of waiting, which are halved until it is tight.

The other end of the scale is a play of layer 0 alone, sent as early as possible.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from itertools import pairwise

from bench.abr.feasible import earliest_s, open_play
from bench.abr.offers import GROUP_S
from bench.abr.relaxation import Relaxation
from server.abr.link import Link
from server.abr.media import Media
from server.abr.session import SessionConfig
from server.study.qoe import Qoe, QoeConfig, score

TOLERANCE_DB = 0.005
"""The bound may be so far above what the programmes themselves allow."""
ROUNDING_DB = 1e-6
"""Largest error of a programme's solution."""
MOST_PROGRAMMES = 24
"""Then the bound is what it is: still one, but not as close."""
GROWTH = 8.0
"""Ratio between one span of waiting and the next, while they grow."""
ROUNDING_S = 1e-4
"""A gap between two frames that is longer by more than this is a stall."""
LEAST_ROOM_DB = 0.05
"""Least difference at which the bound counts as above layer 0: about ten times the bound's
error."""


@dataclass(frozen=True, slots=True)
class Bound:
    """An upper bound for all plays that respect their maximum lead
    (`DecisionContext.end_birth`)."""

    quality_db: float
    """At least `Qoe.quality_db` of any play that shows all frames."""
    waiting_s: float
    """Least waiting of any play, before the first frame and in stalls."""
    psnr_db: float
    """Mean PSNR where the bound is."""


def bound(
    media: Media,
    link: Link,
    session_config: SessionConfig,
    qoe_config: QoeConfig,
    first_frame: int,
    until_frame: int,
    group_s: float = GROUP_S,
) -> Bound:
    """Bounds all plays of the frames first_frame..until_frame-1; the smaller group_s, the closer.

    Raises InvalidError for frames that are not there, or where no play ever begins.
    """
    play = open_play(media, link, session_config, first_frame, until_frame)
    return _search(Relaxation(play, qoe_config, group_s))


@dataclass(order=True, slots=True)
class _Span:
    """Plays that wait between two times in all."""

    rank_db: float
    """The most that they reach, negative: the best come first."""
    least_s: float
    most_s: float
    value_db: float
    """The most without what waiting costs."""
    psnr_db: float
    """Mean PSNR where that is."""


def _search(relaxation: Relaxation) -> Bound:
    """The bound over all waiting."""
    least_s, most_db, cost_db = relaxation.least_s, relaxation.most_db, relaxation.cost_db
    if not cost_db:
        return Bound(most_db, least_s, most_db)
    fine_s = 0.5 * TOLERANCE_DB / cost_db
    reached_db, solved = -math.inf, 0
    spans = [_span(least_s, math.inf, most_db, most_db, cost_db)]
    while True:
        span = heapq.heappop(spans)
        if -span.rank_db <= reached_db + TOLERANCE_DB or solved == MOST_PROGRAMMES:
            return Bound(-span.rank_db + ROUNDING_DB, least_s, span.psnr_db)
        # More waiting is bought in ever larger pieces: it seldom pays at all.
        over_s = max(span.least_s - least_s, fine_s / GROWTH)
        upto_s = over_s * GROWTH**2 if span.most_s == math.inf else span.most_s - least_s
        middle_s = least_s + math.sqrt(over_s * upto_s)
        found, solved = relaxation.solve(middle_s), solved + 1
        # Nothing that fits is what rounding makes of a tight fit.
        fits = found.quality_db > -math.inf
        value_db, psnr_db = (found.quality_db, found.psnr_db) if fits else (most_db, most_db)
        if fits:
            reached_db = max(reached_db, value_db - cost_db * middle_s)
        heapq.heappush(spans, _span(span.least_s, middle_s, value_db, psnr_db, cost_db))
        heapq.heappush(spans, _span(middle_s, span.most_s, span.value_db, span.psnr_db, cost_db))


def _span(least_s: float, most_s: float, value_db: float, psnr_db: float, cost_db: float) -> _Span:
    return _Span(cost_db * least_s - value_db, least_s, most_s, value_db, psnr_db)


def base_only(
    media: Media,
    link: Link,
    session_config: SessionConfig,
    qoe_config: QoeConfig,
    first_frame: int,
    until_frame: int,
) -> Qoe:
    """A play of layer 0 alone, scored. It waits as little as any can. Raises InvalidError as
    `bound` does."""
    play = open_play(media, link, session_config, first_frame, until_frame)
    shown_s = earliest_s(play)
    gaps_s = [later_s - sooner_s - play.frame_s for sooner_s, later_s in pairwise(shown_s)]
    of_frames = [media.sizes(frame).psnr_db for frame in range(first_frame, until_frame)]
    psnr_db, best_db = [layers[0] for layers in of_frames], [layers[-1] for layers in of_frames]
    stalls = sum(gap_s > ROUNDING_S for gap_s in gaps_s)
    return score(psnr_db, best_db, media.fps, shown_s[0], math.fsum(gaps_s), stalls, qoe_config)


def normalised(quality_db: float, base_db: float, bound_db: float) -> float:
    """Where a play lies between layer 0 alone, 0, and the bound, 1. NaN where nothing more than
    layer 0 can be had.

    Of many plays the means are given: 0 needs no choice at all, and no policy exceeds 1. The mean
    of the plays' own ratios would go by those with almost nothing to gain.
    """
    room_db = bound_db - base_db
    return (quality_db - base_db) / room_db if room_db >= LEAST_ROOM_DB else math.nan
