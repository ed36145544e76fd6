"""`scripts/bench serve`, small, on a real swings-serve: no packet is lost in the measurement."""

from __future__ import annotations

import os
import shutil
import sys
from contextlib import ExitStack

import pytest

from bench.serve.heldplays import measure_plays, show_plays
from bench.serve.killedworkers import KillConfig, measure_kills, show_kills
from bench.serve.livelatency import measure_live
from bench.serve.objectrate import cases_of, measure_objects
from bench.serve.processes import two_cores

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(
        not sys.platform.startswith("linux")
        or (os.cpu_count() or 1) < 2
        or not shutil.which("taskset"),
        reason="it needs Linux, two cores and taskset",
    ),
]


def nothing(pid: int) -> ExitStack:
    return ExitStack()


def test_plays_are_measured(capsys: pytest.CaptureFixture[str]) -> None:
    figures = measure_plays(2, 400, 0.1, 0.5, two_cores(), (), nothing)
    assert (figures.clients, figures.failed, figures.missing, figures.double) == (2, 0, 0, 0)
    assert 0 < figures.head_ms.p50 <= figures.record_ms.p50 <= figures.picture_ms.p50
    assert figures.layers > 1
    show_plays(figures)
    printed = capsys.readouterr().out
    for column in ("2 plays", "first picture, ms", "slices late, ms", "missing", "% of a core"):
        assert column in printed


def test_killed_workers_cost_their_clients_no_slice(capsys: pytest.CaptureFixture[str]) -> None:
    figures = measure_kills(KillConfig(2, 1.0, clients=4, frame_bytes=400, arrive_s=0.3))
    assert (figures.clients, figures.kills) == (4, 2)
    assert (figures.lost, figures.missing, figures.double, figures.broken) == (0, 0, 0, 0)
    assert set(figures.reports) <= {"204", "404", "0"}
    show_kills(figures)
    assert "2 kills, 4 clients" in capsys.readouterr().out


def test_a_live_stream_reaches_who_follows_it() -> None:
    figures = measure_live(3, 4000, 6.0, two_cores(), ())
    assert figures.segments >= 3 * 5
    # The clock of file times has steps of a few ms.
    assert -20 < figures.first_ms.p50 <= figures.last_ms.p50 < 3000


def test_objects_are_measured_beside_others() -> None:
    for program in ("nginx", "wrk"):
        if not shutil.which(program) and not shutil.which(program, path="/usr/sbin"):
            pytest.skip(f"{program} is not installed")
    rates = measure_objects((20,), 1, 1.0, 8, two_cores(), (), nothing)
    # The bare response of aiohttp supports neither ranges nor conditions.
    assert len(rates) == 3 * len(cases_of((20,))) + 1
    assert all(rate.requests_per_s > 10 and rate.cpu_us_per_request > 0 for rate in rates)
    assert {rate.to_nginx for rate in rates if rate.server == "nginx"} == {1.0}
