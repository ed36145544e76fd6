"""The pure core of /play, against a link made of arithmetic."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.abr.policy import FixedPolicy, LayerPolicy
from server.abr.session import Finished, PlaySession, SendSlice, SessionConfig, WaitForFrames
from tests.server.abr.simulated_play import FPS, FakeMedia, simulate, steady


@given(
    first_frame=st.integers(0, 59),
    length=st.none() | st.integers(1, 100),
    layers=st.integers(1, 4),
)
@settings(max_examples=30, deadline=None)
def test_it_sends_exactly_the_births_that_show(
    first_frame: int, length: int | None, layers: int
) -> None:
    media = FakeMedia(num_frames=60)
    until = None if length is None else first_frame + length
    log = simulate(media, FixedPolicy(layers), steady(1e9), first_frame, until)
    last = min(60, until or 60)
    births = list(range(first_frame - media.swin_size + 1, last))
    assert [send.birth for _, send in log.decided] == births
    assert set(log.layers) == {layers}
    assert log.ended_s is not None


@given(
    rate_bps=st.floats(0.5e6, 1e9),
    target_s=st.floats(0.2, 4),
    burst=st.floats(0.05, 1),
)
@settings(max_examples=20, deadline=None)
def test_the_lead_is_bounded_and_births_are_never_early(
    rate_bps: float, target_s: float, burst: float
) -> None:
    config = SessionConfig(target_lead_s=target_s, burst_s=burst * target_s)
    log = simulate(FakeMedia(120), LayerPolicy(), steady(rate_bps), config=config, for_s=20)
    for now_s, send in log.decided:
        if send.birth > 0:
            started_s = min(log.arrived_s.get(0, now_s), now_s)
            assert send.birth / FPS - (now_s - started_s) <= target_s + 0.01


@pytest.mark.parametrize(("share", "layers"), [(1.4, 1), (2.5, 2), (3.6, 3), (9.0, 4), (500, 4)])
@pytest.mark.parametrize("round_trip_s", [0.0, 0.05])
def test_a_steady_link_gets_what_it_sustains_without_stalls(
    share: float, layers: int, round_trip_s: float
) -> None:
    media = FakeMedia(600)
    rate_bps = steady(share * media.need_bps(1))
    log = simulate(media, LayerPolicy(), rate_bps, round_trip_s=round_trip_s)
    settled = log.layers[-300:]
    assert sum(settled) / len(settled) == pytest.approx(layers, abs=0.35)
    assert log.stall_s(0, FPS) <= 0.01
    assert sum(a != b for a, b in pairwise(log.layers[60:])) <= 12


def test_a_faster_link_never_gets_less() -> None:
    means = []
    for share in (0.8, 1.2, 1.8, 2.4, 3.2, 4.2, 6, 20):
        log = simulate(FakeMedia(), LayerPolicy(), steady(share * FakeMedia().need_bps(1)))
        means.append(sum(log.layers) / len(log.layers))
    assert means == sorted(means)
    assert means[0] == pytest.approx(1, abs=0.1)
    assert means[-1] > 3.5


def test_the_first_picture_comes_in_time_where_the_base_layer_can() -> None:
    # The base layer of the window is 80 KB: 1.28 Mbit/s for half a second.
    for rate_bps in (2e6, 4e6, 8e6, 50e6):
        log = simulate(FakeMedia(), LayerPolicy(), steady(rate_bps))
        assert log.arrived_s[0] <= 0.55


@pytest.mark.parametrize("round_trip_s", [0.004, 0.02, 0.05, 0.1])
def test_a_fast_but_distant_client_has_all_layers_soon(round_trip_s: float) -> None:
    media = FakeMedia(300)
    log = simulate(media, LayerPolicy(), steady(100e6), round_trip_s=round_trip_s)
    # The first window goes out blind, the rest does not.
    assert log.layers[: media.swin_size] == [1] * media.swin_size
    later = log.layers[media.swin_size + 15 :]
    assert later.count(4) / len(later) > 0.9
    assert log.stall_s(0, FPS) <= 0.01


def test_it_drops_when_the_link_falls_and_climbs_when_it_is_back() -> None:
    media = FakeMedia(1200)

    def rate_bps(now_s: float) -> float:
        return media.need_bps(1) * (1.5 if 10 <= now_s < 20 else 8)

    log = simulate(media, LayerPolicy(), rate_bps)
    dip = [send.num_layers for now_s, send in log.decided if 12 < now_s < 20]
    later = [send.num_layers for now_s, send in log.decided if now_s > 26]
    assert max(dip) <= 2
    assert dip.count(1) / len(dip) > 0.8
    assert later.count(4) / len(later) > 0.95
    assert log.stall_s(0, FPS) <= 0.01


def test_an_outage_shifts_the_clock_instead_of_racing_after_it() -> None:
    media = FakeMedia(900)

    def rate_bps(now_s: float) -> float:
        return 0.0 if 5 <= now_s < 12 else 40 * media.need_bps(1)

    log = simulate(media, LayerPolicy(), rate_bps)
    stalled_s = log.stall_s(0, FPS)
    assert 4.5 < stalled_s < 6  # seven seconds less the lead
    assert log.ended_s is not None
    assert log.ended_s == pytest.approx(900 / FPS + stalled_s - 2, abs=0.7)


def test_at_the_live_edge_it_waits_and_keeps_its_layers() -> None:
    media = FakeMedia(0, live=True)

    def grow(now_s: float) -> int:
        return 15 * int(now_s / 0.5)

    log = simulate(media, LayerPolicy(), steady(100e6), grow=grow, for_s=20)
    assert [send.birth for _, send in log.decided] == list(range(-9, grow(19.95)))
    settled = [send.num_layers for now_s, send in log.decided if now_s > 5]
    assert settled.count(4) / len(settled) > 0.9
    assert log.ended_s is None


def test_a_live_stream_that_finishes_ends_the_play() -> None:
    media = FakeMedia(30, live=True)
    session = PlaySession(media, FixedPolicy(1), SessionConfig(), 0.0, 20)
    sends = 0
    while isinstance(session.decide(0.0, 0), SendSlice):
        session.sending(100, 0.0, 0)
        sends += 1
    assert sends == 10 + 9
    assert session.decide(0.0, 0) == WaitForFrames()
    media.live = False
    assert session.decide(0.1, 0) == Finished()


def test_until_ends_a_play_of_a_live_stream() -> None:
    session = PlaySession(FakeMedia(30, live=True), FixedPolicy(1), SessionConfig(), 0.0, 5, 7)
    births = []
    while isinstance(decision := session.decide(0.0, 0), SendSlice):
        births.append(decision.birth)
        session.sending(100, 0.0, 0)
    assert births == list(range(-4, 7))
    assert decision == Finished()
