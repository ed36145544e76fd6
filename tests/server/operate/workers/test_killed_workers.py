"""Workers that are killed under 50 clients: nobody loses a slice, or the quality that they had."""

from __future__ import annotations

import sys

import pytest

from bench.serve.killedworkers import KillConfig, measure_kills

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="several workers need Linux"),
]


@pytest.mark.slow
def test_killed_workers_cost_their_clients_a_moment_and_the_others_nothing() -> None:
    """`scripts/bench serve --parts kills` kills 100."""
    seen = measure_kills(KillConfig(kills=15, every_s=1.5, max_lead_s=2.0))
    assert (seen.clients, seen.kills) == (50, 15)
    assert seen.victims > 100
    assert seen.lost == 0
    assert (seen.missing, seen.double) == (0, 0)
    assert seen.refused == 0
    assert seen.stalls == 0
    assert seen.resume_ms.p99 < 1000
    # Where a client comes back it is sent a picture first, a few slices with one layer.
    assert seen.after > seen.before - 0.5
    assert seen.broken == 0
    assert seen.gap_ms.p99 < 1000
    assert set(seen.reports) <= {"204", "404", "0"}
