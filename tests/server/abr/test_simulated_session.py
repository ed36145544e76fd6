"""Sessions in virtual time, where they came to nothing once."""

from __future__ import annotations

import pytest

from server.abr.link.link import Link, LinkStep
from server.abr.playout import PlayoutConfig
from server.abr.policies.choice import fixed_policy
from server.abr.session import SessionConfig
from server.abr.simulate.simulator import play_out, simulate
from tests.server.abr.policies.made_media import MadeMedia, sizes_of


def test_a_play_begins_however_short_its_lead_may_be() -> None:
    # At 25 fps the client waits for three frames, but 0.1 s are two and a half.
    media = MadeMedia((sizes_of((2e3,), (25.0,)),), num_frames=20, fps=25.0)
    link = Link([LinkStep(1.0, 1e6, 0.01)])
    for config in (
        SessionConfig(max_lead_s=0.1),
        SessionConfig(max_lead_s=0.02, playout=PlayoutConfig(start_lead_s=0.5)),
    ):
        result = simulate(media, fixed_policy(1), link, config, at_most_s=30)
        assert len(play_out(media, result, config, 0, 20)[0]) == 20


@pytest.mark.parametrize("layer_bytes", [8426.3, 14657.87, 10_000.1, 9_999.9])
def test_parts_of_bytes_do_not_keep_an_idle_link_busy(layer_bytes: float) -> None:
    media = MadeMedia((sizes_of((layer_bytes,), (25.0,)),), num_frames=450, fps=25.0)
    rate_bps = 200 * 8 * layer_bytes
    link = Link([LinkStep(1.0, rate_bps, 0.02)])
    result = simulate(media, fixed_policy(1), link, keep_estimates=True)
    # The lead is full after half a second; from then on the link rests most of the time.
    assert result.estimates[-1][1] == pytest.approx(rate_bps, rel=0.6)
