"""Whole layers: the best plan is what trying all plans gives, and the bounds lie above it."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.link.link import Link
from server.abr.oracle.bound import TOLERANCE_DB, bound
from server.abr.oracle.feasible import Play, open_play
from server.abr.oracle.groups import Group, group_frames
from server.abr.oracle.mixed import mixed_bound
from server.abr.oracle.programme import best_plan
from server.abr.qoe import QoeConfig, score
from server.abr.session import SessionConfig
from server.abr.simulate.simulator import Arrival, Simulated, play_out, send_bytes
from tests.server.abr.oracle.made_up_streams import (
    make_link,
    make_rules,
    make_span,
    make_stream,
    play_through,
)
from tests.server.abr.oracle.odd_policies import Planned, planned_sends

Rules = tuple[SessionConfig, QoeConfig]
seeds = st.integers(0, 1 << 32)


def plan_quality_db(
    play: Play, link: Link, rules: Rules, groups: tuple[Group, ...], plan: tuple[int, ...]
) -> float:
    """What `plan` is worth, sent as early as it may be: by the client's own code. -inf where it
    takes a layer up that it cannot."""
    media = play.media
    sends = planned_sends(media, groups, plan)
    if sends is None:
        return -math.inf
    free_s, time_s, shown_s = 0.0, 0.0, []  # type: float, float, list[float]
    arrivals = []
    for number, some in enumerate(sends):
        if number >= play.lead_frames:
            free_s = max(free_s, shown_s[number - play.lead_frames])
        for send in some:
            num_bytes = send_bytes(media, send)
            free_s = link.passed_s(free_s, num_bytes)  # type: ignore[arg-type, unused-ignore]
            time_s = free_s + link.steps[0].latency_s
            arrivals.append(Arrival(time_s, num_bytes, send))
        if number + 1 == play.start_frames:
            shown_s = [time_s + n / media.fps for n in range(number + 1)]
        elif number >= play.start_frames:
            shown_s.append(max(shown_s[-1] + 1 / media.fps, time_s))
    span = play.first_frame, play.until_frame
    shown, clock = play_out(media, Simulated(arrivals), rules[0], *span)
    assert len(shown) == play.num_frames
    assert clock.started_s is not None
    psnr_db = [frame.psnr_db for frame in shown]
    qoe = score(psnr_db, media.fps, clock.started_s, clock.stalled_s, clock.stalls, rules[1])
    return qoe.quality_db


@given(seed=seeds, has_slots=st.booleans())
@settings(max_examples=20, deadline=None)
def test_the_best_plan_is_the_best_of_all(seed: int, has_slots: bool) -> None:
    rng = np.random.default_rng(seed)
    media = make_stream(rng, has_slots, seconds=1.5, fps=6, num_layers=3, segment_frames=4)
    link, rules = make_link(rng, media.need_bps, even=True), make_rules(rng)
    span = make_span(rng, media)
    play = open_play(media, link, rules[0], *span)
    groups = group_frames(play, rules[1], 1.0).groups
    found = best_plan(media, link, *rules, *span, 1.0)
    best_db = max(
        plan_quality_db(play, link, rules, groups, plan)
        for plan in product(range(1, 4), repeat=len(groups))
    )
    assert found.quality_db == pytest.approx(best_db, abs=1e-5)
    reached_db = plan_quality_db(play, link, rules, groups, found.num_layers)
    assert reached_db == pytest.approx(best_db, abs=1e-5)


@given(seed=seeds, has_slots=st.booleans())
@settings(max_examples=10, deadline=None)
def test_bounds_lie_above_plans_and_plans_above_plays(seed: int, has_slots: bool) -> None:
    rng = np.random.default_rng(seed)
    layers = int(rng.integers(2, 4))
    media = make_stream(rng, has_slots, seconds=2, fps=6, num_layers=layers, segment_frames=6)
    link, rules = make_link(rng, media.need_bps), make_rules(rng)
    span = make_span(rng, media)
    found = bound(media, link, *rules, *span)
    mixed = mixed_bound(media, link, *rules, *span)
    plan = best_plan(media, link, *rules, *span)
    assert found.quality_db >= mixed.quality_db - TOLERANCE_DB
    assert mixed.quality_db >= plan.quality_db - 1e-6
    groups = group_frames(open_play(media, link, rules[0], *span), rules[1]).groups
    played = play_through(media, Planned(media, groups, plan.num_layers), link, rules, *span)
    if played is not None:
        assert played.quality_db <= plan.quality_db + 1e-6


def test_a_small_case_is_told_from_one_that_is_not() -> None:
    media = make_stream(np.random.default_rng(0), False, seconds=40, fps=5, num_layers=4)
    link = make_link(np.random.default_rng(0), media.need_bps)
    with pytest.raises(InvalidError, match="different plays"):
        best_plan(media, link, SessionConfig(), QoeConfig(), 0, 200)
    with pytest.raises(InvalidError, match="decisions"):
        mixed_bound(media, link, SessionConfig(), QoeConfig(), 0, 200)
