"""Sessions in virtual time, in situations in which they once failed."""

from __future__ import annotations

import pytest

from server.abr.fixedlayers import FixedLayers
from server.abr.link.link import Link, LinkStep
from server.abr.playout import PlayoutConfig
from server.abr.session import SessionConfig
from server.study.simulate.simulator import play_out, simulate
from tests.support.delivery.media import MadeMedia, sizes_of


def test_a_play_begins_however_short_its_lead_may_be() -> None:
    # At 25 fps the client waits for three frames, but 0.1 s are two and a half.
    media = MadeMedia((sizes_of((2e3,), (25.0,)),), num_frames=20, fps=25.0)
    link = Link([LinkStep(1.0, 1e6, 0.01)])
    for config in (
        SessionConfig(max_lead_s=0.1),
        SessionConfig(max_lead_s=0.02, playout=PlayoutConfig(start_lead_s=0.5)),
    ):
        result = simulate(media, FixedLayers(1), link, config, at_most_s=30)
        assert len(play_out(media, result, config, 0, 20)[0]) == 20


@pytest.mark.parametrize("layer_bytes", [8426.3, 14657.87, 10_000.1, 9_999.9])
def test_parts_of_bytes_do_not_keep_an_idle_link_busy(layer_bytes: float) -> None:
    media = MadeMedia((sizes_of((layer_bytes,), (25.0,)),), num_frames=450, fps=25.0)
    rate_bps = 200 * 8 * layer_bytes
    link = Link([LinkStep(1.0, rate_bps, 0.02)])
    result = simulate(media, FixedLayers(1), link, keep_estimates=True)
    # The lead is full after half a second; from then on the link rests most of the time.
    assert result.estimates[-1][1] == pytest.approx(rate_bps, rel=0.1)


@pytest.mark.parametrize("latency_s", [0.0, 0.02, 0.15, 0.4])
@pytest.mark.parametrize("num_layers", [1, 2])
def test_what_is_sent_little_by_little_does_not_make_a_link_slow(
    latency_s: float, num_layers: int
) -> None:
    # The lead is soon full, and further data needs a tenth or a half of the link.
    media = MadeMedia((sizes_of((10e3, 40e3), (25.0, 1.0)),), num_frames=450)
    rate_bps = 24e6
    link = Link([LinkStep(1.0, rate_bps, latency_s)])
    result = simulate(media, FixedLayers(num_layers), link, keep_estimates=True)
    measured = [estimate for _, estimate, _ in result.estimates if estimate]
    assert len(measured) > 100
    assert measured == pytest.approx([rate_bps] * len(measured), rel=0.01)


def test_a_link_that_slows_down_during_a_rest_is_noticed() -> None:
    media = MadeMedia((sizes_of((20e3,), (25.0,)),), num_frames=900)
    link = Link([LinkStep(10.0, 48e6, 0.05), LinkStep(100.0, 6e6, 0.05)])
    result = simulate(media, FixedLayers(1), link, keep_estimates=True)
    rates = {time_s: estimate for time_s, estimate, _ in result.estimates}
    assert rates[max(t for t in rates if t < 10)] == pytest.approx(48e6, rel=0.01)
    assert rates[max(t for t in rates if t < 11)] == pytest.approx(6e6, rel=0.02)


@pytest.mark.parametrize("latency_s", [0.02, 0.1, 0.3])
def test_a_link_that_recovers_is_noticed_however_little_is_underway(latency_s: float) -> None:
    # At first so few bytes may be in flight that the link pauses between packets.
    media = MadeMedia((sizes_of((10e3, 30e3), (25.0, 1.0)),), num_frames=450)
    link = Link([LinkStep(10.0, 0.5e6, latency_s), LinkStep(100.0, 20e6, latency_s)])
    result = simulate(media, FixedLayers(2), link, keep_estimates=True)
    rates = {time_s: estimate for time_s, estimate, _ in result.estimates}
    assert rates[max(t for t in rates if t < 10)] == pytest.approx(0.5e6, rel=0.01)
    soon_s = 11.0 + 5 * latency_s
    assert rates[max(t for t in rates if t < soon_s)] == pytest.approx(20e6, rel=0.05)
