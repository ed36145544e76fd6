"""Whole plays in virtual time: what a link carries is shown, and nothing stalls without need."""

from __future__ import annotations

from statistics import fmean

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.abr.holding import SliceHolding
from server.abr.link.link import Link, LinkStep
from server.abr.media import SegmentSizes
from server.abr.outlook import SendSlices, SendSnapshots
from server.abr.playout import PlayoutClock
from server.abr.policies.choice import fixed_policy, own_policy
from server.abr.session import PlaySession, SessionConfig
from server.abr.simulate.simulator import Shown, play_out, send_bytes, simulate
from server.abr.slotholding import open_holding
from server.abr.standing import Standing
from tests.support.delivery.media import MadeMedia, demo_media, slot_media

LATENCY_S = 0.02
CONFIG = SessionConfig()


def link_of(*steps: tuple[float, float]) -> Link:
    """A link of (seconds, Mbit/s)."""
    return Link([LinkStep(duration_s, rate * 1e6, LATENCY_S) for duration_s, rate in steps])


def played(
    media: MadeMedia, link: Link, layers: int | None = None
) -> tuple[list[Shown], PlayoutClock]:
    """What a client shows of all of `media`."""
    policy = own_policy(media) if layers is None else fixed_policy(layers)
    result = simulate(media, policy, link, CONFIG)
    return play_out(media, result, CONFIG, 0, media.num_frames)


def mean_layers(shown: list[Shown]) -> float:
    return fmean(one.layers for one in shown)


@pytest.mark.parametrize(
    ("link", "num_frames", "least"),
    [
        (link_of((0.8, 12), (0.8, 4), (1.5, 12)), 300, 3.9),
        (link_of((10, 12), (10, 4), (60, 12)), 900, 3.8),
        (link_of((60, 3.9)), 900, 1.9),
        (link_of((60, 7.8)), 900, 3.9),
        (link_of((60, 100)), 300, 3.9),
        (link_of((60, 3.1)), 900, 1.4),
    ],
    ids=["demo", "step", "3.9", "7.8", "100", "3.1"],
)
def test_what_the_link_carries_is_shown_without_a_stall(
    link: Link, num_frames: int, least: float
) -> None:
    shown, clock = played(demo_media(num_frames), link)
    assert len(shown) == num_frames
    assert clock.stalls == 0
    assert mean_layers(shown) >= least


@pytest.mark.parametrize("share", [1.1, 1.3, 2.0])
@pytest.mark.parametrize("media", [demo_media(), slot_media()], ids=["version 1", "version 2"])
def test_a_link_that_carries_layer_0_never_stalls(media: MadeMedia, share: float) -> None:
    shown, clock = played(media, link_of((60, share * media.need_bps(1) / 1e6)))
    assert len(shown) == media.num_frames
    assert clock.stalls == 0


@pytest.mark.parametrize(
    ("rate", "least_db"), [(5.5, 28.2), (7.0, 28.85), (9.0, 29.3), (12.0, 29.45), (50, 29.6)]
)
def test_where_slots_last_the_picture_goes_with_the_link(rate: float, least_db: float) -> None:
    shown, clock = played(slot_media(), link_of((60, rate)))
    assert clock.stalls == 0
    assert fmean(one.psnr_db for one in shown) >= least_db


def random_media(has_slots: bool, layers: int, seed: int) -> MadeMedia:
    each = tuple(2e3 * (1 + (seed >> 3 * n) % 8) for n in range(layers))
    psnr_db = tuple(25.0 + 4 * n / layers for n in range(layers))
    slots = (tuple(20 * size for size in each), (0.2,) * layers) if has_slots else ((), ())
    return MadeMedia(
        (SegmentSizes(each, psnr_db, *slots),), 240, segment_frames=20, has_slots=has_slots
    )


steps = st.lists(
    st.tuples(st.floats(0.2, 5), st.sampled_from([0.0, 0.3, 1.0, 3.0, 10.0])),
    min_size=1,
    max_size=6,
).filter(lambda steps: any(rate for _, rate in steps))


@given(st.booleans(), st.integers(1, 4), st.integers(0, 1 << 12), steps, st.integers(0, 239))
@settings(max_examples=60, deadline=None)
def test_each_packet_comes_once_where_it_is_of_use_and_the_play_ends(
    has_slots: bool, layers: int, seed: int, steps: list[tuple[float, float]], first: int
) -> None:
    media = random_media(has_slots, layers, seed)
    result = simulate(media, own_policy(media), link_of(*steps), CONFIG, first)
    holding, came = open_holding(media, first), set()
    for arrival in result.arrivals:
        what = arrival.what
        if isinstance(what, SendSnapshots):
            for layer in range(what.first_layer, what.end_layer):
                assert ("snapshot", what.frame, layer) not in came
                came.add(("snapshot", what.frame, layer))
            holding.add_snapshots(what.frame, what.first_layer, what.end_layer)
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
    st.booleans(),
    st.lists(
        st.tuples(st.floats(0.2, 5), st.sampled_from([1.15, 1.3, 2.0, 3.0, 10.0, 30.0])),
        min_size=1,
        max_size=7,
    ),
)
@settings(max_examples=40, deadline=None)
def test_a_link_that_always_carries_layer_0_never_stalls_however_it_changes(
    has_slots: bool, steps: list[tuple[float, float]]
) -> None:
    media = slot_media(450) if has_slots else demo_media(450)
    need = media.need_bps(1) / 1e6
    shown, clock = played(media, link_of(*((seconds, share * need) for seconds, share in steps)))
    assert len(shown) == media.num_frames
    assert clock.stalls == 0


@given(st.booleans(), st.integers(0, 1 << 12), steps)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_upper_layers_cost_no_more_than_the_first_outages(
    has_slots: bool, seed: int, steps: list[tuple[float, float]]
) -> None:
    """Whoever is sent layer 0 alone waits least; ours waits little longer."""
    media = random_media(has_slots, 3, seed)
    link = link_of(*steps)
    _, least = played(media, link, layers=1)
    _, ours = played(media, link)
    assert least.started_s is not None
    assert ours.started_s is not None
    # Layer 0 alone is sent as far ahead as may be; ours has to see first that there are outages.
    slack_s = CONFIG.max_lead_s + 2.0 + 0.3 * least.stalled_s
    assert ours.started_s + ours.stalled_s <= least.started_s + least.stalled_s + slack_s


@pytest.mark.parametrize("rates", [(20, 5), (5, 20), (100, 25), (25, 100), (16, 4), (4, 16)])
def test_the_estimate_follows_a_link_that_changes_fourfold(rates: tuple[float, float]) -> None:
    before, after = rates
    media = random_media(False, 4, 0)
    scale = 1.5e6 * max(rates) / media.need_bps(4)  # the link is never idle
    sizes = tuple(scale * size for size in media.sizes(0).layer_bytes)
    media = MadeMedia((SegmentSizes(sizes, media.sizes(0).psnr_db),), 300, segment_frames=30)
    result = simulate(
        media, own_policy(media), link_of((5, before), (60, after)), CONFIG,
        at_most_s=8, keep_estimates=True,
    )  # fmt: skip
    for time_s, rate_bps, queued in result.estimates:
        expected = before if time_s < 5 else after
        if 1 < time_s < 5 or time_s > 6:
            assert rate_bps == pytest.approx(expected * 1e6, rel=0.1)
            assert queued * 8 / (expected * 1e6) <= 0.25


def test_the_simulator_is_the_same_every_time() -> None:
    link = link_of((2, 9), (1, 0.5), (3, 5))
    media = slot_media(300)
    assert simulate(media, own_policy(media), link) == simulate(media, own_policy(media), link)


@pytest.mark.parametrize("steps_before", [0, 20])
def test_a_still_picture_gets_all_layers_of_all_slices_that_it_shows(steps_before: int) -> None:
    """Also of those that would have shown for a frame or two only."""
    media, frame, now_s = demo_media(120), 60, 0.0
    session = PlaySession(media, own_policy(media), CONFIG, now_s, frame)
    for n in range(2000):
        if n == steps_before:
            frame = session.next_frame
        if n >= steps_before:
            session.told(now_s, Standing(frame, paused=True))
        decision = session.decide(now_s)
        if isinstance(decision, SendSlices):
            session.sent(decision, send_bytes(media, decision), now_s)
        now_s += 0.005
        session.acknowledge(now_s, session.sent_bytes)
    holding = session.holding
    assert isinstance(holding, SliceHolding)
    shows = range(frame - media.swin_size + 1, frame + 1)
    assert [holding.level(birth) for birth in shows] == [media.num_layers] * len(shows)
