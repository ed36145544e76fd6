"""What no policy can beat on a link, even if it knows all of it beforehand.

For plays that wait between a and b seconds in all, a linear programme in which everything is due
as late as a play of b seconds may have it is the most that PSNR and steps can be, and a is the
least that waiting costs. The bound is the largest over all such spans of waiting, and they are
halved until that tells.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass

from ..link.link import Link
from ..media import Media
from ..qoe import QoeConfig
from ..session import SessionConfig
from .feasible import open_play
from .groups import GROUP_S
from .relaxation import Relaxation, Solution

TOLERANCE_DB = 0.005
"""The bound may be so far above what the programmes themselves allow."""
ROUNDING_DB = 1e-6
"""What the programmes may be off by."""
MOST_PROGRAMMES = 24
"""Then the bound is what it is: still one, but not as close."""
GROWTH = 8.0
"""Of one span of waiting to the next, as long as they grow."""


@dataclass(frozen=True, slots=True)
class Bound:
    """What no play can beat that keeps to the lead it may have (`Outlook.end_birth`)."""

    quality_db: float
    """At least `Qoe.quality_db` of any play that shows all frames."""
    waiting_s: float
    """What any play waits at least, before the first frame and in stalls."""
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
    relaxation = Relaxation(play, qoe_config, group_s)
    return search(relaxation.solve, relaxation)


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


def search(solve: Callable[[float], Solution], relaxation: Relaxation) -> Bound:
    """The bound over all waiting. solve: the best of plays that wait so much or less, `relaxation`
    or what adds rules to it."""
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
        found, solved = solve(middle_s), solved + 1
        # Nothing that fits is what rounding makes of a tight fit.
        fits = found.quality_db > -math.inf
        value_db, psnr_db = (found.quality_db, found.psnr_db) if fits else (most_db, most_db)
        if fits:
            reached_db = max(reached_db, value_db - cost_db * middle_s)
        heapq.heappush(spans, _span(span.least_s, middle_s, value_db, psnr_db, cost_db))
        heapq.heappush(spans, _span(middle_s, span.most_s, span.value_db, span.psnr_db, cost_db))


def _span(least_s: float, most_s: float, value_db: float, psnr_db: float, cost_db: float) -> _Span:
    return _Span(cost_db * least_s - value_db, least_s, most_s, value_db, psnr_db)
