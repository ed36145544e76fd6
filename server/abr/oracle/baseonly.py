"""A play of layer 0 alone, sent as early as it may be: where the scale of policies begins."""

from __future__ import annotations

import math
from itertools import pairwise

from ..link.link import Link
from ..media import Media
from ..qoe import Qoe, QoeConfig, score
from ..session import SessionConfig
from .feasible import earliest_s, open_play

ROUNDING_S = 1e-4
LEAST_ROOM_DB = 0.05
"""Layer 0 and the bound are told apart from here on; the bound is known to about a tenth of it."""


def base_only(
    media: Media,
    link: Link,
    session_config: SessionConfig,
    qoe_config: QoeConfig,
    first_frame: int,
    until_frame: int,
) -> Qoe:
    """The play, scored. It waits as little as any can. Raises InvalidError as `bound` does."""
    play = open_play(media, link, session_config, first_frame, until_frame)
    shown_s = earliest_s(play)
    gaps_s = [later_s - sooner_s - play.frame_s for sooner_s, later_s in pairwise(shown_s)]
    psnr_db = [media.sizes(frame).psnr_db[0] for frame in range(first_frame, until_frame)]
    stalls = sum(gap_s > ROUNDING_S for gap_s in gaps_s)
    return score(psnr_db, media.fps, shown_s[0], math.fsum(gaps_s), stalls, qoe_config)


def normalised(quality_db: float, base_db: float, bound_db: float) -> float:
    """Where a play lies between layer 0 alone, 0, and the bound, 1. NaN where nothing more than
    layer 0 can be had."""
    room_db = bound_db - base_db
    return (quality_db - base_db) / room_db if room_db >= LEAST_ROOM_DB else math.nan
