"""The bound holds for every play, and is not needlessly high."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import accumulate, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.abr.bound import base_only, bound, normalised
from bench.abr.feasible import earliest_s, latest_s, open_play, waiting_s
from codec.errors import InvalidError
from server.abr.decisioncontext import FixedLayers, Policy
from server.abr.link import Link, LinkStep
from server.abr.media import SegmentSizes
from server.abr.playout import PlayoutConfig
from server.abr.session import SessionConfig
from server.study.choice import POLICIES, make_policy
from server.study.qoe import Qoe, QoeConfig, score
from server.study.simulator import play_out, simulate
from tests.support.delivery.media import MadeMedia


def make_stream(
    rng: np.random.Generator,
    seconds: float = 12.0,
    fps: float | None = None,
    num_layers: int | None = None,
    segment_frames: int | None = None,
) -> MadeMedia:
    fps = fps or float(rng.choice([5, 10, 12]))
    num_layers = num_layers or int(rng.integers(1, 5))
    segment_frames = segment_frames or int(rng.choice([3, 7, 10, 15]))
    num_frames = max(2, int(seconds * fps))
    segments = []
    for _ in range(-(-num_frames // segment_frames)):
        layer_bytes = rng.uniform(2e3, 2e4, num_layers)
        if rng.random() < 0.1:
            layer = int(rng.integers(num_layers))
            # A sender takes nothing of layer 0 for something that has come at once.
            layer_bytes[layer] = 0.0 if layer else 1.0
        gains_db = [20 + 8 * rng.random(), *rng.uniform(0, 3, num_layers - 1).tolist()]
        keyframes = layer_bytes * rng.uniform(0.5, 12, num_layers)
        changed = rng.choice([0.0, 0.1, 0.3, 1.0], num_layers, p=[0.1, 0.4, 0.4, 0.1])
        segments.append(
            SegmentSizes(
                tuple(layer_bytes.tolist()),
                tuple(accumulate(gains_db)),
                tuple(keyframes.tolist()),
                tuple(changed.tolist()),
            )
        )
    return MadeMedia(tuple(segments), num_frames, fps, segment_frames=segment_frames)


def make_link(rng: np.random.Generator, media: MadeMedia) -> Link:
    """A link with outages that carries a part of the stream, or slightly more than all."""
    mean_bps = max(1e4, media.need_bps(media.num_layers)) * rng.uniform(0.3, 2.0)
    same_s = float(rng.uniform(0, 0.1)) if rng.random() < 0.6 else None
    steps = []
    for _ in range(int(rng.integers(1, 12))):
        rate_bps = 0.0 if rng.random() < 0.2 else mean_bps * float(rng.exponential())
        latency_s = float(rng.uniform(0, 0.4)) if same_s is None else same_s
        steps.append(LinkStep(float(rng.uniform(0.1, 4)), rate_bps, latency_s))
    steps.append(LinkStep(float(rng.uniform(0.5, 4)), mean_bps, same_s or 0.0))
    return Link(steps)


def make_rules(rng: np.random.Generator) -> tuple[SessionConfig, QoeConfig]:
    session = SessionConfig(
        max_lead_s=float(rng.choice([1.0, 2.5, 6.0])),
        first_bytes=int(rng.choice([4_000, 64_000])),
        playout=PlayoutConfig(start_lead_s=float(rng.choice([0.0, 0.1, 0.8]))),
    )
    qoe = QoeConfig(
        stall_db=float(rng.choice([5.0, 33.0])),
        switch_db=float(rng.choice([0.0, 1.0, 4.0])),
        stretch_s=float(rng.choice([0.5, 1.3])),
    )
    return session, qoe


def make_span(rng: np.random.Generator, media: MadeMedia) -> tuple[int, int]:
    """First frame of a play, and one past its last; mostly more than a second apart."""
    if rng.random() < 0.5:
        return 0, media.num_frames
    first = int(rng.integers(0, media.num_frames // 2))
    return first, int(rng.integers(first + 1 + media.num_frames // 4, media.num_frames + 1))


def play_through(
    media: MadeMedia,
    policy: Policy,
    link: Link,
    rules: tuple[SessionConfig, QoeConfig],
    first_frame: int,
    until_frame: int,
) -> Qoe | None:
    """The score of a play of all these frames; None if some never showed."""
    session, qoe = rules
    result = simulate(media, policy, link, session, first_frame, until_frame, at_most_s=300.0)
    shown, clock = play_out(media, result, session, first_frame, until_frame)
    if len(shown) < until_frame - first_frame:
        return None
    assert clock.started_s is not None
    psnr_db = [frame.psnr_db for frame in shown]
    best_db = [media.sizes(frame).psnr_db[-1] for frame in range(first_frame, until_frame)]
    found = score(psnr_db, best_db, media.fps, clock.started_s, clock.stalled_s, clock.stalls, qoe)
    assert score(best_db, best_db, media.fps, 0, 0, 0, qoe).step_db == 0  # whatever the scene does
    assert sum(db < found.low_psnr_db for db in psnr_db) <= 0.05 * len(psnr_db)
    assert sum(db <= found.low_psnr_db for db in psnr_db) > 0.05 * len(psnr_db) - 1e-9
    return found


RULES = (SessionConfig(), QoeConfig())
seeds = st.integers(0, 1 << 32)


def steady(rate_bps: float) -> Link:
    return Link([LinkStep(60.0, rate_bps, 0.02)])


@given(seed=seeds, group_s=st.sampled_from([0.2, 0.5, 1.0]))
@settings(max_examples=30, deadline=None)
def test_no_play_beats_it(seed: int, group_s: float) -> None:
    rng = np.random.default_rng(seed)
    media = make_stream(rng, seconds=rng.uniform(5, 20))
    link, rules, span = make_link(rng, media), make_rules(rng), make_span(rng, media)
    found = bound(media, link, *rules, *span, group_s)
    policies: list[Policy] = [FixedLayers(int(rng.integers(1, media.num_layers + 1)))]
    policies += [make_policy(name) for name in rng.choice(sorted(POLICIES), 3, replace=False)]
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
    link, rules, span = make_link(rng, media), make_rules(rng), make_span(rng, media)
    found = bound(media, link, *rules, *span)
    base = base_only(media, link, *rules, *span)
    whole_db = float(np.mean([media.sizes(frame).psnr_db[-1] for frame in range(*span)]))
    wait_db = base.psnr_db - rules[1].switch_db * base.step_db - base.quality_db
    assert base.quality_db <= found.quality_db <= whole_db - wait_db + 1e-5
    assert base.startup_s + base.stalled_s == pytest.approx(found.waiting_s)


def test_a_link_that_carries_all_gives_all_layers() -> None:
    rng = np.random.default_rng(3)
    media = make_stream(rng, seconds=20, fps=10, num_layers=4, segment_frames=10)
    alike = replace(media, segments=media.segments[:1])
    found = bound(alike, steady(20 * alike.need_bps(4)), *RULES, 0, alike.num_frames)
    all_db = alike.sizes(0).psnr_db[-1]
    assert found.psnr_db == pytest.approx(all_db, abs=1e-6)
    assert found.waiting_s < 0.2
    assert found.quality_db == pytest.approx(all_db - 33 * found.waiting_s / 20, abs=0.01)


def test_half_of_a_layer_is_half_of_its_worth() -> None:
    """For a long play on a link between one and two layers, the bound is on the line between."""
    # A keyframe is worth 5 slices, and takes more.
    sizes = SegmentSizes((1e4, 1e4), (30.0, 34.0), (1e5, 1e5), (0.2, 0.2))
    media = MadeMedia((sizes,), 600, fps=10, segment_frames=10)
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


@given(seed=seeds, more_s=st.floats(0, 5))
@settings(max_examples=30, deadline=None)
def test_frames_show_between_two_times(seed: int, more_s: float) -> None:
    rng = np.random.default_rng(seed)
    media = make_stream(rng)
    link, (session, _) = make_link(rng, media), make_rules(rng)
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
    media = MadeMedia((sizes,), 200, fps=10, segment_frames=10)
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
