"""Links whose rate drops and rises while data is sent: a token bucket of the kernel (root), and the
emulated link."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from contextlib import ExitStack, suppress
from pathlib import Path
from threading import Thread

import pytest

from bench.network.shaped import TCP_SHARE, shaped_link, why_not
from player.link.linkprocess import LinkProcess
from server.abr.link.link import Link, LinkStep
from tests.support.delivery.pump import Told

ROOT = Path(__file__).parents[2]

NEEDS_TBF = pytest.mark.skipif(why_not() is not None, reason=str(why_not()))
CHANGES = (16.0, 4.0), (4.0, 16.0), (100.0, 25.0), (25.0, 100.0)
"""Rates before and after the change, Mbit/s."""
SPELL_S = 2.2
"""Duration of each rate: a second to find it, and the rest to keep it."""


def knows(over: str, before: float, after: float) -> list[Told]:
    """Data of a session over a link of `before`, then `after` Mbit/s, each for SPELL_S."""
    share = TCP_SHARE if over == "tbf" else 1.0
    link = Link([LinkStep(SPELL_S, mbps * 1e6 / share, 0.02) for mbps in (before, after)])
    with ExitStack() as stack:
        host, shaped = "127.0.0.1", None
        pump = [sys.executable, "-m", "tests.support.delivery.pump"]
        if over == "tbf":
            shaped = stack.enter_context(shaped_link(link))
            host, pump = shaped.host, shaped.inside(*pump)
        rates_bps = 1e6 * min(before, after), 1e6 * max(before, after)
        command = [*pump, host, *map(str, (*rates_bps, 2 * SPELL_S))]
        process = stack.enter_context(
            subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        )
        stack.callback(process.kill)
        assert process.stdout is not None
        where = host, int(process.stdout.readline())
        if shaped is None:
            where = stack.enter_context(LinkProcess(link, *where)).address
        client = stack.enter_context(socket.create_connection(where, timeout=30))
        if shaped is not None:
            shaped.start()
        Thread(target=read_all, args=(client,)).start()
        return [Told(*json.loads(line)) for line in process.stdout]


def read_all(client: socket.socket) -> None:
    with suppress(OSError):  # the connection is over
        while client.recv(1 << 16):
            pass


def faults(told: list[Told], before: float, after: float) -> list[str]:
    """Deviations from the expected state, shortly before the change and from a second after it."""
    found = []
    for one in told:
        if one.time_s < SPELL_S - 0.5 or SPELL_S <= one.time_s < SPELL_S + 1.0:
            continue
        mbps = before if one.time_s < SPELL_S else after
        if abs((one.rate_bps or 0.0) / 1e6 / mbps - 1) > 0.1:
            found.append(f"{one}: the estimate is not within 10 % of {mbps} Mbit/s")
        if 8 * one.queued_bytes > 0.25 * 1e6 * mbps:
            found.append(f"{one}: over 0.25 s of {mbps} Mbit/s are unacknowledged")
    if told[-1].stalls > max(one.stalls for one in told if one.time_s < SPELL_S):
        found.append(f"{told[-1]}: it stalled after the change")
    return found


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("over", "rates"),
    [
        *(pytest.param("tbf", rates, marks=NEEDS_TBF) for rates in CHANGES),
        ("link", CHANGES[0]),
        ("link", CHANGES[3]),
    ],
)
def test_a_fourfold_change_is_known_within_a_second(over: str, rates: tuple[float, float]) -> None:
    told = knows(over, *rates)
    assert told[-1].time_s > 2 * SPELL_S - 0.5
    assert not faults(told, *rates)
