"""Wasted bytes, counted by hand and against plays that waste nothing."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.abr.decisioncontext import Send, SendSlices, SendSnapshots
from server.abr.link.link import Link, LinkStep
from server.abr.session import SessionConfig
from server.study.policies.choice import POLICIES
from server.study.simulate.simulator import Arrival, Shown, play_out, send_bytes, simulate
from server.study.simulate.waste import measure_traffic
from tests.support.delivery.media import MadeMedia, basketball_media

CONFIG = SessionConfig()


def came(media: MadeMedia, *sends: tuple[float, Send]) -> list[Arrival]:
    return [Arrival(time_s, send_bytes(media, send), send) for time_s, send in sends]


def shown_at_once(media: MadeMedia, count: int) -> list[Shown]:
    """Frames 0..count-1, frame n at second n."""
    return [Shown(n, float(n), float(n), 1.0, 30.0) for n in range(count)]


def wasted(media: MadeMedia, count: int, *sends: tuple[float, Send]) -> float:
    return measure_traffic(media, came(media, *sends), shown_at_once(media, count)).wasted_bytes


def slices(births: range, first_layer: int, end_layer: int) -> SendSlices:
    return SendSlices(births, first_layer, end_layer)


JOIN = (0.0, SendSnapshots(0, 0, 1))
CHAIN = (0.0, slices(range(1, 10), 0, 1))


UP, AT_5 = (0.0, SendSnapshots(0, 1, 2)), SendSnapshots(5, 1, 2)


def changes_of(begin: int, end: int, time_s: float = 0.0) -> tuple[float, Send]:
    """The slices of layer 1 from `begin` to before `end`."""
    return time_s, slices(range(begin, end), 1, 2)


@pytest.mark.parametrize(
    ("sends", "changes", "snapshots"),
    [
        ([UP, changes_of(1, 10)], 0, 0),
        ([changes_of(1, 10)], 9, 0),  # changes without a snapshot
        ([UP, changes_of(2, 10)], 8, 0),  # a gap
        ([UP, changes_of(1, 10, 9.5)], 9, 0),  # too late
        ([UP, changes_of(1, 10), changes_of(2, 3, 1.0)], 1, 0),  # the same slices twice
        # A snapshot replaces a chain whose end had not arrived.
        ([UP, changes_of(1, 3), (4.5, AT_5), changes_of(3, 4, 5.5), changes_of(6, 10, 5.6)], 1, 0),
        ([UP, changes_of(1, 10), (2.0, AT_5)], 0, 1),  # of a state that is there already
        # The next snapshot arrives early, and the chain reaches it later.
        ([UP, (0.0, AT_5), changes_of(1, 10)], 0, 0),
        # A layer does not show without the layer below it.
        ([(0.0, SendSnapshots(0, 2, 3)), (0.0, slices(range(1, 10), 2, 3))], 9, 1),
    ],
)
def test_what_no_chain_shows_is_wasted(
    sends: list[tuple[float, Send]], changes: int, snapshots: int
) -> None:
    media = basketball_media()
    layer = 2 if sends[0][1].first_layer == 2 else 1
    expected = (
        changes * media.sizes(0).layer_bytes[layer]
        + snapshots * media.sizes(0).snapshot_bytes[layer]
    )
    assert wasted(media, 10, JOIN, CHAIN, *sends) == pytest.approx(expected)


@given(
    policy=st.sampled_from(sorted(POLICIES)),
    loads=st.lists(st.floats(0.2, 3), min_size=1, max_size=6),
)
@settings(max_examples=15, deadline=None)
def test_waste_is_a_share_of_what_came(policy: str, loads: list[float]) -> None:
    media = basketball_media(150)
    link = Link([LinkStep(1.0, load * media.need_bps(4), 0.02) for load in loads])
    result = simulate(media, POLICIES[policy](media), link, CONFIG)
    shown, _ = play_out(media, result, CONFIG, 0, media.num_frames)
    traffic = measure_traffic(media, result.arrivals, shown)
    assert 0 <= traffic.wasted_share < 1
    assert traffic.came_bytes == pytest.approx(sum(one.num_bytes for one in result.arrivals))
    # Every frame showed, which needs layer 0: the first snapshot, and all changes or as many bytes.
    sizes = media.sizes(0)
    least_bytes = sizes.snapshot_bytes[0] + (media.num_frames - 1) * sizes.layer_bytes[0]
    assert traffic.came_bytes - traffic.wasted_bytes >= 0.99 * least_bytes
    assert measure_traffic(media, result.arrivals, []).wasted_share == 1
