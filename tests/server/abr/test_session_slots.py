"""Sessions of streams whose slots last: what the client holds, and what snapshots cost."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.abr.estimator import ThroughputEstimator
from server.abr.policy import FixedPolicy, LayerPolicy, Policy, Situation
from server.abr.session import (
    Finished,
    PlaySession,
    SendSlice,
    SendSnapshots,
    SessionConfig,
    WaitForFrames,
)
from tests.server.abr.simulated_play import FPS, FakeMedia, Log, simulate, steady


def slot_media(num_frames: int = 300, **changes: object) -> FakeMedia:
    values: dict[str, object] = {"num_frames": num_frames, "has_slots": True} | changes
    return FakeMedia(**values)  # type: ignore[arg-type]


@dataclass
class Whims:
    """Any number of layers at any time."""

    rng: np.random.Generator
    seen: list[Situation] = field(default_factory=list)

    def choose_layers(self, situation: Situation) -> int:
        self.seen.append(situation)
        return int(self.rng.integers(1, situation.num_layers + 1))


def check_order(log: Log, media: FakeMedia, first_frame: int, until: int) -> list[int]:
    """Each slice once and in order, and none with a layer that the client does not hold whole;
    gives the frames whose snapshots took layers up again."""
    start = first_frame // media.segment_frames * media.segment_frames
    first, *rest = log.sent
    assert isinstance(first, SendSnapshots)
    assert (first.frame, first.first_layer) == (start, 0)
    held, last, taken_up = first.num_layers, start, []
    for send in rest:
        if isinstance(send, SendSlice):
            assert send.birth == last + 1
            assert 1 <= send.num_layers <= held
            held, last = send.num_layers, send.birth
        else:
            assert send.frame == last
            assert last % media.segment_frames == 0
            assert send.first_layer == held < send.num_layers
            held = send.num_layers
            taken_up.append(last)
    assert last == max(until - 1, start)
    return taken_up


@given(
    first_frame=st.integers(0, 59),
    length=st.none() | st.integers(1, 100),
    segment_frames=st.sampled_from([1, 4, 15, 100]),
    rate_bps=st.floats(1e6, 1e9),
    seed=st.none() | st.integers(0, 1 << 32),
)
@settings(max_examples=60, deadline=None)
def test_a_layer_is_sent_only_while_the_client_holds_it(
    first_frame: int, length: int | None, segment_frames: int, rate_bps: float, seed: int | None
) -> None:
    media = slot_media(60, segment_frames=segment_frames)
    policy: Policy = LayerPolicy() if seed is None else Whims(np.random.default_rng(seed))
    until = None if length is None else first_frame + length
    log = simulate(media, policy, steady(rate_bps), first_frame, until)
    check_order(log, media, first_frame, min(60, until or 60))
    assert log.ended_s is not None


@pytest.mark.parametrize("layers", [1, 3])
def test_a_fixed_number_of_layers_is_never_dropped(layers: int) -> None:
    media = slot_media(60)
    log = simulate(media, FixedPolicy(layers), steady(3e6), 7)
    assert not check_order(log, media, 7, 60)
    assert log.sent[0] == SendSnapshots(0, 0, layers)
    assert set(log.layers) == {layers}


def test_a_join_chooses_by_all_that_is_due_before_the_first_picture() -> None:
    # With two layers 200 KB of snapshots and 14 slices of 16 KB: 3.4 Mbit for half a second.
    for rate_bps, layers in ((9e6, 2), (6e6, 1), (1e9, 4)):
        media = slot_media(60)
        estimator = ThroughputEstimator(rate_bps=rate_bps)
        session = PlaySession(media, LayerPolicy(), SessionConfig(), 0.0, 14, estimator=estimator)
        assert session.decide(0.0, 0) == SendSnapshots(0, 0, layers)


def test_the_slices_before_the_first_picture_keep_the_layers() -> None:
    policy = Whims(np.random.default_rng(3))
    session = PlaySession(slot_media(60), policy, SessionConfig(), 0.0, 12)
    snapshots = session.decide(0.0, 0)
    assert isinstance(snapshots, SendSnapshots)
    for birth in range(1, 13):
        assert session.decide(0.0, 0) == SendSlice(birth, snapshots.num_layers)
    assert len(policy.seen) == 1


@dataclass
class Steered:
    """What the test says."""

    layers: int

    def choose_layers(self, situation: Situation) -> int:
        return self.layers


def test_what_is_taken_up_costs_at_most_its_share_of_the_lead() -> None:
    # At 8 Mbit/s half of a lead of 1.5 s is 750 KB.
    for layer_bytes, taken in ((100_000.0, 4), (300_000.0, 3), (751_000.0, 1)):
        media, policy = slot_media(90, snapshot_layer_bytes=layer_bytes), Steered(1)
        session = PlaySession(
            media, policy, SessionConfig(), 0.0, estimator=ThroughputEstimator(rate_bps=8e6)
        )
        while session.next_birth < 45:
            session.decide(0.0, 0)
        policy.layers = 4
        assert session.decide(0.0, 0) == SendSlice(45, 1)
        if taken > 1:
            assert session.decide(0.0, 0) == SendSnapshots(45, 1, taken)
        assert session.decide(0.0, 0) == SendSlice(46, taken)


@pytest.mark.parametrize("rate_share", [1.5, 2.5, 9.0])
@pytest.mark.parametrize("round_trip_s", [0.0, 0.05])
def test_a_steady_link_gets_what_it_sustains_without_stalls(
    rate_share: float, round_trip_s: float
) -> None:
    media = slot_media(600)
    rate_bps = steady(rate_share * media.need_bps(1))
    log = simulate(media, LayerPolicy(), rate_bps, round_trip_s=round_trip_s)
    settled = log.layers[-300:]
    assert sum(settled) / len(settled) > min(4, int(rate_share)) - 0.6
    assert log.stall_s(0, FPS) <= 0.01


def test_it_drops_at_once_and_comes_back_with_a_segment() -> None:
    media = slot_media(1200)

    def rate_bps(now_s: float) -> float:
        return media.need_bps(1) * (1.5 if 10 <= now_s < 20 else 8)

    log = simulate(media, LayerPolicy(), rate_bps)
    assert check_order(log, media, 0, 1200)
    dip = [send.num_layers for now_s, send in log.decided if 13 < now_s < 20]
    later = [send.num_layers for now_s, send in log.decided if now_s > 27]
    assert dip.count(1) / len(dip) > 0.8
    assert later.count(4) / len(later) > 0.95
    assert log.stall_s(0, FPS) <= 0.01


def test_a_live_stream_is_joined_before_it_has_a_segment() -> None:
    media = slot_media(0, live=True)
    session = PlaySession(media, FixedPolicy(2), SessionConfig(), 0.0)
    assert session.decide(0.0, 0) == WaitForFrames()
    media.num_frames = 15
    assert session.decide(0.1, 0) == SendSnapshots(0, 0, 2)
    sent = []
    while isinstance(decision := session.decide(0.1, 0), SendSlice):
        sent.append(decision.birth)
    assert sent == list(range(1, 15))
    assert decision == WaitForFrames()
    media.live = False
    assert session.decide(0.2, 0) == Finished()


def test_one_frame_is_a_snapshot_and_no_more() -> None:
    session = PlaySession(slot_media(60), FixedPolicy(2), SessionConfig(), 0.0, 15, 16)
    assert session.decide(0.0, 0) == SendSnapshots(15, 0, 2)
    assert session.decide(0.0, 0) == Finished()
