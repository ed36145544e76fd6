"""Plays of layer 0 alone, and bounds on the times at which frames show."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.abr.link.link import Link, LinkStep
from server.abr.media import SegmentSizes
from server.abr.session import SessionConfig
from server.study.oracle.bound import base_only, normalised
from server.study.oracle.feasible import earliest_s, latest_s, open_play, waiting_s
from server.study.simulate.qoe import QoeConfig
from tests.server.study.oracle.made_up_streams import (
    Stream,
    make_link,
    make_rules,
    make_span,
    make_stream,
)

seeds = st.integers(0, 1 << 32)
RULES = (SessionConfig(), QoeConfig())


@given(seed=seeds, more_s=st.floats(0, 5))
@settings(max_examples=30, deadline=None)
def test_frames_show_between_two_times(seed: int, more_s: float) -> None:
    rng = np.random.default_rng(seed)
    media = make_stream(rng)
    link, (session, _) = make_link(rng, media.need_bps), make_rules(rng)
    play = open_play(media, link, session, *make_span(rng, media))
    earliest = earliest_s(play)
    least_s = waiting_s(play, earliest[-1])
    latest = latest_s(play, least_s + more_s)
    assert waiting_s(play, latest[-1]) == pytest.approx(least_s + more_s)
    for shown_s in (earliest, latest):
        assert all(b - a >= play.frame_s - 1e-9 for a, b in pairwise(shown_s))
    assert all(a <= b + 1e-9 for a, b in zip(earliest, latest, strict=True))


def test_a_long_outage_holds_frames_up_however_long_was_waited_before() -> None:
    sizes = SegmentSizes((1e3,), (30.0,), (1e3,), (0.1,))
    media = Stream(10, 10, 200, 1, (sizes,) * 20)
    link = Link([LinkStep(10.0, 8e6, 0.0), LinkStep(20.0, 0.0, 0.0), LinkStep(100.0, 8e6, 0.0)])
    base = base_only(media, link, *RULES, 0, 200)
    # The lead is six seconds when the outage begins.
    assert base.startup_s == pytest.approx(0.001, abs=1e-5)
    assert base.stalled_s == pytest.approx(14.0, abs=0.2)
    assert base.stalls == 1
    play = open_play(media, link, SessionConfig(), 0, 200)
    latest = latest_s(play, base.startup_s + base.stalled_s + 0.01)
    # Frames before the outage can hardly wait, because a lead of six seconds is needed.
    assert latest[99] < 10.2
    assert latest[170] > 30


@pytest.mark.parametrize(
    ("quality_db", "share"), [(30.0, 0.0), (32.0, 0.5), (34.0, 1.0), (26.0, -1.0)]
)
def test_the_scale_goes_from_layer_0_to_the_bound(quality_db: float, share: float) -> None:
    assert normalised(quality_db, 30.0, 34.0) == pytest.approx(share)
    assert math.isnan(normalised(quality_db, 30.0, 30.01))
