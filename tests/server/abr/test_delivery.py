"""Whole plays in virtual time: the link is used for quality, and there are no needless stalls."""

from __future__ import annotations

from dataclasses import replace
from statistics import fmean

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.abr.clientstatus import ClientStatus
from server.abr.decisioncontext import FixedLayers, SendKeyframes, SendSlices
from server.abr.holding import Holding
from server.abr.link import Link, LinkStep
from server.abr.media import SegmentSizes
from server.abr.playout import PlayoutClock
from server.abr.session import PlaySession, SessionConfig
from server.abr.sweep import Sweep
from server.study.simulator import Shown, play_out, send_bytes, simulate
from tests.support.delivery.media import MadeMedia, basketball_media, sizes_of

LATENCY_S = 0.02
CONFIG = SessionConfig()


def link_of(*steps: tuple[float, float]) -> Link:
    """A link with steps of (seconds, Mbit/s)."""
    return Link([LinkStep(duration_s, rate * 1e6, LATENCY_S) for duration_s, rate in steps])


def played(
    media: MadeMedia, link: Link, layers: int | None = None
) -> tuple[list[Shown], PlayoutClock]:
    """The frames that a client shows of all of `media`, and its clock."""
    policy = Sweep() if layers is None else FixedLayers(layers)
    result = simulate(media, policy, link, CONFIG)
    return play_out(media, result, CONFIG, 0, media.num_frames)


def mean_layers(shown: list[Shown]) -> float:
    return fmean(one.layers for one in shown)


@pytest.mark.parametrize(
    ("link", "num_frames", "least"),
    [
        (link_of((0.8, 14), (0.8, 5), (1.5, 14)), 300, 3.45),
        (link_of((10, 14), (10, 5), (60, 14)), 900, 3.8),
        (link_of((60, 5.6)), 900, 2.0),
        (link_of((60, 9.5)), 900, 3.5),
        (link_of((60, 100)), 300, 3.9),
    ],
    ids=["demo", "step", "5.6", "9.5", "100"],
)
def test_what_the_link_carries_is_shown_without_a_stall(
    link: Link, num_frames: int, least: float
) -> None:
    shown, clock = played(basketball_media(num_frames), link)
    assert len(shown) == num_frames
    assert clock.stalls == 0
    assert mean_layers(shown) >= least


@pytest.mark.parametrize(
    ("rate", "least_db"), [(5.5, 28.2), (7.0, 28.85), (9.0, 29.3), (12.0, 29.45), (50, 29.6)]
)
def test_the_picture_goes_with_the_link(rate: float, least_db: float) -> None:
    shown, clock = played(basketball_media(), link_of((60, rate)))
    assert clock.stalls == 0
    assert fmean(one.psnr_db for one in shown) >= least_db


def random_media(layers: int, seed: int) -> MadeMedia:
    each = tuple(2e3 * (1 + (seed >> 3 * n) % 8) for n in range(layers))
    psnr_db = tuple(25.0 + 4 * n / layers for n in range(layers))
    keyframes = tuple(20 * size for size in each)
    segments = (SegmentSizes(each, psnr_db, keyframes, (0.2,) * layers),)
    return MadeMedia(segments, 240, segment_frames=20)


steps = st.lists(
    st.tuples(st.floats(0.2, 5), st.sampled_from([0.0, 0.3, 1.0, 3.0, 10.0])),
    min_size=1,
    max_size=6,
).filter(lambda steps: any(rate for _, rate in steps))


@given(st.integers(1, 4), st.integers(0, 1 << 12), steps, st.integers(0, 239))
@settings(max_examples=60, deadline=None)
def test_each_packet_comes_once_where_it_is_of_use_and_the_play_ends(
    layers: int, seed: int, steps: list[tuple[float, float]], first: int
) -> None:
    media = random_media(layers, seed)
    result = simulate(media, Sweep(), link_of(*steps), CONFIG, first)
    holding, came = Holding(media, first), set()
    for arrival in result.arrivals:
        what = arrival.what
        if isinstance(what, SendKeyframes):
            for layer in range(what.first_layer, what.end_layer):
                assert ("keyframe", what.frame, layer) not in came
                came.add(("keyframe", what.frame, layer))
            holding.add_keyframes(what.frame, what.first_layer, what.end_layer)
            continue
        assert isinstance(what, SendSlices)
        for birth in what.births:
            assert birth < media.num_frames
            for layer in range(what.first_layer, what.end_layer):
                assert ("slice", birth, layer) not in came
                came.add(("slice", birth, layer))
            if what.first_layer == 0:
                assert birth == holding.end_frame or birth < first
            holding.add(birth, what.first_layer, what.end_layer)
    assert holding.end_frame == media.num_frames
    shown, _ = play_out(media, result, CONFIG, first, media.num_frames)
    assert [one.frame for one in shown] == list(range(first, media.num_frames))
    assert all(1 <= one.layers <= layers for one in shown)


@given(
    st.lists(
        st.tuples(st.floats(0.2, 5), st.sampled_from([1.1, 1.3, 2.0, 3.0, 10.0, 30.0])),
        min_size=1,
        max_size=7,
    )
)
@settings(max_examples=40, deadline=None)
def test_a_link_that_always_carries_layer_0_never_stalls_however_it_changes(
    steps: list[tuple[float, float]],
) -> None:
    media = basketball_media(450)
    need = media.need_bps(1) / 1e6
    shown, clock = played(media, link_of(*((seconds, share * need) for seconds, share in steps)))
    assert len(shown) == media.num_frames
    assert clock.stalls == 0


@pytest.mark.parametrize("seed", range(40))
def test_upper_layers_cost_no_more_than_the_first_outages(seed: int) -> None:
    """A client of layer 0 alone waits least; with our policy it waits little longer."""
    media = random_media(3, seed)
    rng = np.random.default_rng(seed)
    rates = [1.0, *rng.choice([0.0, 0.3, 1.0, 3.0, 10.0], rng.integers(0, 6))]
    link = link_of(*((rng.uniform(0.2, 5), float(rate)) for rate in rng.permutation(rates)))
    _, least = played(media, link, layers=1)
    _, ours = played(media, link)
    assert least.started_s is not None
    assert ours.started_s is not None
    # Layer 0 alone is sent with the whole lead; ours must first notice that there are outages.
    slack_s = CONFIG.max_lead_s + 2.0 + 0.3 * least.stalled_s
    assert ours.started_s + ours.stalled_s <= least.started_s + least.stalled_s + slack_s


@pytest.mark.parametrize("rates", [(20, 5), (5, 20), (100, 25), (25, 100), (16, 4), (4, 16)])
def test_the_estimate_follows_a_link_that_changes_fourfold(rates: tuple[float, float]) -> None:
    before, after = rates
    media = random_media(4, 0)
    scale = 1.5e6 * max(rates) / media.need_bps(4)  # the link is never idle
    sizes = media.sizes(0)
    faster = replace(sizes, layer_bytes=tuple(scale * size for size in sizes.layer_bytes))
    media = MadeMedia((faster,), 300, segment_frames=30)
    result = simulate(media, Sweep(), link_of((5, before), (60, after)), CONFIG, at_most_s=8)
    for time_s, rate_bps, queued in result.estimates:
        expected = before if time_s < 5 else after
        if 1 < time_s < 5 or time_s > 6:
            assert rate_bps == pytest.approx(expected * 1e6, rel=0.1)
            assert queued * 8 / (expected * 1e6) <= 0.25


def test_the_simulator_is_the_same_every_time() -> None:
    link = link_of((2, 9), (1, 0.5), (3, 5))
    media = basketball_media(300)
    assert simulate(media, Sweep(), link) == simulate(media, Sweep(), link)


@pytest.mark.parametrize("steps_before", [0, 20])
@pytest.mark.parametrize("frame", [60, 73, 88, 89])
@pytest.mark.parametrize("until_frame", [None, 105])
def test_a_still_picture_gets_all_layers(
    frame: int, steps_before: int, until_frame: int | None
) -> None:
    """This holds for any place in its segment, also if the next segment's keyframe costs less than
    its own with the later changes."""
    media, now_s = MadeMedia((sizes_of((3e3, 3e3, 1.5e3), (28, 1, 0.5)),)), 0.0
    session = PlaySession(media, Sweep(), CONFIG, now_s, frame, until_frame)
    for n in range(2000):
        if n == steps_before:
            frame = session.next_frame
        if n >= steps_before:
            session.on_status(now_s, ClientStatus(frame, paused=True))
        decision = session.decide(now_s)
        if isinstance(decision, SendSlices | SendKeyframes):
            session.sent(decision, send_bytes(media, decision), now_s)
        now_s += 0.005
        session.acknowledge(now_s, session.sent_bytes)
    assert session.holding.shares(frame) == [1.0] * media.num_layers
