"""The bound holds for every play, and is not needlessly high."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.decisioncontext import Policy
from server.abr.link.link import Link, LinkStep
from server.abr.media import SegmentSizes
from server.abr.playout import PlayoutConfig
from server.abr.session import SessionConfig
from server.abr.sweep import Sweep
from server.study.oracle.bound import TOLERANCE_DB, base_only, bound
from server.study.oracle.feasible import open_play
from server.study.simulate.qoe import QoeConfig
from tests.server.study.oracle.made_up_streams import (
    Stream,
    Whims,
    make_link,
    make_rules,
    make_span,
    make_stream,
    play_through,
)

RULES = (SessionConfig(), QoeConfig())
seeds = st.integers(0, 1 << 32)


def steady(rate_bps: float) -> Link:
    return Link([LinkStep(60.0, rate_bps, 0.02)])


@given(seed=seeds, group_s=st.sampled_from([0.2, 0.5, 1.0]))
@settings(max_examples=30, deadline=None)
def test_no_play_beats_it(seed: int, group_s: float) -> None:
    rng = np.random.default_rng(seed)
    media = make_stream(rng, seconds=rng.uniform(5, 20))
    link, rules, span = make_link(rng, media.need_bps), make_rules(rng), make_span(rng, media)
    found = bound(media, link, *rules, *span, group_s)
    policies: list[Policy] = [Whims(rng), Whims(rng), Sweep()]
    for policy in policies:
        qoe = play_through(media, policy, link, rules, *span)
        if qoe is not None:
            assert qoe.quality_db <= found.quality_db
            assert qoe.startup_s + qoe.stalled_s >= found.waiting_s - 1e-6


@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_it_lies_between_layer_0_and_all_layers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    media = make_stream(rng)
    link, rules, span = make_link(rng, media.need_bps), make_rules(rng), make_span(rng, media)
    found = bound(media, link, *rules, *span)
    base = base_only(media, link, *rules, *span)
    whole_db = float(np.mean([media.sizes(frame).psnr_db[-1] for frame in range(*span)]))
    wait_db = base.psnr_db - rules[1].switch_db * base.step_db - base.quality_db
    assert base.quality_db <= found.quality_db <= whole_db - wait_db + 1e-5
    assert base.startup_s + base.stalled_s == pytest.approx(found.waiting_s)


@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_a_better_link_or_a_longer_lead_is_worth_no_less(seed: int) -> None:
    rng = np.random.default_rng(seed)
    media = make_stream(rng, seconds=6)
    link, (session, qoe) = make_link(rng, media.need_bps), make_rules(rng)
    found = bound(media, link, session, qoe, 0, media.num_frames).quality_db
    faster = Link([replace(step, rate_bps=1.3 * step.rate_bps) for step in link.steps])
    further = replace(session, max_lead_s=session.max_lead_s + 1)
    for better in ((faster, session), (link, further)):
        more = bound(media, *better, qoe, 0, media.num_frames).quality_db
        assert more >= found - TOLERANCE_DB - 1e-5


def test_a_link_that_carries_all_gives_all_layers() -> None:
    rng = np.random.default_rng(3)
    media = make_stream(rng, seconds=20, fps=10, num_layers=4, segment_frames=10)
    alike = replace(media, segments=media.segments[:1] * len(media.segments))
    found = bound(alike, steady(20 * alike.need_bps), *RULES, 0, alike.num_frames)
    all_db = alike.sizes(0).psnr_db[-1]
    assert found.psnr_db == pytest.approx(all_db, abs=1e-6)
    assert found.waiting_s < 0.2
    assert found.quality_db == pytest.approx(all_db - 33 * found.waiting_s / 20, abs=0.01)


def test_half_of_a_layer_is_half_of_its_worth() -> None:
    """For a long play on a link between one and two layers, the bound is on the line between."""
    # A snapshot is worth 5 slices, and takes more.
    sizes = SegmentSizes((1e4, 1e4), (30.0, 34.0), (1e5, 1e5), (0.2, 0.2))
    media = Stream(10, 10, 600, 2, (sizes,) * 60)
    found = bound(media, steady(8 * 10 * 1.5e4), *RULES, 0, 600)
    # The lead and the stored bytes at the ends count little over a minute.
    assert found.psnr_db == pytest.approx(32.0, abs=0.15)


@pytest.mark.parametrize(
    ("span", "lead_s", "group_s", "message"),
    [
        ((-1, 5), 0.1, 0.5, "frames"),
        ((5, 5), 0.1, 0.5, "frames"),
        ((0, 21), 0.1, 0.5, "frames"),
        ((0, 20), 1.5, 0.5, "the play cannot start"),
        ((0, 20), 0.1, 0.0, "group_s"),
    ],
)
def test_what_is_asked_must_make_sense(
    span: tuple[int, int], lead_s: float, group_s: float, message: str
) -> None:
    media = make_stream(np.random.default_rng(0), seconds=2, fps=10)
    session = SessionConfig(max_lead_s=1.0, playout=PlayoutConfig(start_lead_s=lead_s))
    with pytest.raises(InvalidError, match=message):
        bound(media, steady(1e6), session, QoeConfig(), *span, group_s)


def test_a_lead_that_ends_stalls_is_granted_to_the_bound_too() -> None:
    media = make_stream(np.random.default_rng(0), seconds=2, fps=10)
    session = SessionConfig(max_lead_s=0.1, playout=PlayoutConfig(0.0, resume_lead_s=0.5))
    play = open_play(media, steady(1e6), session, 0, media.num_frames)
    assert play.lead_frames == session.lead_frames(10) == 5
