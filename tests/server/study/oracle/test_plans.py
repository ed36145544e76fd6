"""Plans that give whole groups a number of layers: none of them beats the bound."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from server.abr.link.link import Link
from server.abr.session import SessionConfig
from server.study.oracle.bound import bound
from server.study.oracle.feasible import Play, open_play
from server.study.oracle.offers import Group, group_frames
from server.study.simulate.qoe import QoeConfig, score
from server.study.simulate.simulator import Arrival, Simulated, play_out, send_bytes
from tests.server.study.oracle.made_up_streams import (
    make_link,
    make_rules,
    make_span,
    make_stream,
    play_through,
)
from tests.server.study.oracle.odd_policies import Planned, planned_sends

Rules = tuple[SessionConfig, QoeConfig]


def plan_quality_db(
    play: Play, link: Link, rules: Rules, groups: tuple[Group, ...], plan: tuple[int, ...]
) -> float:
    """QoE of `plan`, sent as early as allowed, by the client's own code. -inf if it starts a layer
    where that is not possible."""
    media = play.media
    sends = planned_sends(media, groups, plan)
    if sends is None:
        return -math.inf
    free_s, time_s = 0.0, 0.0
    arrivals, shown_s = list[Arrival](), list[float]()
    for number, some in enumerate(sends):
        if number >= play.lead_frames:
            free_s = max(free_s, shown_s[number - play.lead_frames])
        for send in some:
            num_bytes = send_bytes(media, send)
            free_s = link.passed_s(free_s, num_bytes)
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


@given(seed=st.integers(0, 1 << 32))
@settings(max_examples=20, deadline=None)
def test_the_bound_lies_above_all_plans_and_the_best_above_its_play(seed: int) -> None:
    rng = np.random.default_rng(seed)
    layers = int(rng.integers(2, 4))
    media = make_stream(rng, seconds=2, fps=6, num_layers=layers, segment_frames=6)
    link, rules = make_link(rng, media.need_bps, even=True), make_rules(rng)
    span = make_span(rng, media)
    play = open_play(media, link, rules[0], *span)
    groups = group_frames(play, rules[1], 1.0).groups
    found_db = {
        plan: plan_quality_db(play, link, rules, groups, plan)
        for plan in product(range(1, layers + 1), repeat=len(groups))
    }
    best = max(found_db, key=lambda plan: found_db[plan])
    assert bound(media, link, *rules, *span).quality_db >= found_db[best] - 1e-6
    played = play_through(media, Planned(media, groups, best), link, rules, *span)
    if played is not None:
        assert played.quality_db <= found_db[best] + 1e-6
