"""The emulated link in real time: it carries what it says, and a server sees it like a real one."""

from __future__ import annotations

import asyncio
import contextlib
import select
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from statistics import median

import pytest

import server.answers.play
from player.link.linkprocess import LinkProcess
from player.link.linktext import read_link
from server.abr.session import Decision, PlaySession
from server.exchange.tcpinfo import unacked_bytes
from tests.player.link.pouring import drain, pouring
from tests.support.server.running_server import make_stream, quick_config, running

pytestmark = pytest.mark.realtime

SETTLED_S = 0.4
"""Seconds after which a play is measured: the first bytes only determine the rate of the link."""

NUM_FRAMES = 130
SLICE_SIZE = 1600
"""Gaussians of 56 bytes, 30 slices a second: 21 Mbit/s, sent up to six seconds ahead."""

Noted = list[tuple[float, float, float]]
"""(time, estimate in bit/s, unacknowledged bytes)"""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("served")
    make_stream(root / "wide", NUM_FRAMES, SLICE_SIZE)
    return root


def times_s(text: str, num_bytes: int, connections: int = 1) -> tuple[float, float]:
    """When the first byte has come of a server that pours `num_bytes` on each of so many
    connections, and when all have."""
    with (
        pouring(num_bytes) as server,
        LinkProcess(read_link(text), "127.0.0.1", server.port) as relay,
        ThreadPoolExecutor(connections) as pool,
    ):
        began_s = time.monotonic()
        others = [pool.submit(drain, relay.address) for _ in range(connections - 1)]
        with socket.create_connection(relay.address, timeout=30) as connection:
            assert connection.recv(1)
            first_s = time.monotonic() - began_s
            while connection.recv(65536):
                pass
        for other in others:
            other.result()
        return first_s, time.monotonic() - began_s


@pytest.mark.parametrize(
    ("text", "num_bytes", "connections", "first_s", "all_s"),
    [
        ("8M", 1_000_000, 1, 0.0, 1.0),
        ("8M", 150_000, 4, 0.0, 0.6),
        ("40M,150ms", 1_000_000, 1, 0.15, 0.35),
    ],
)
def test_bytes_take_their_time(
    text: str, num_bytes: int, connections: int, first_s: float, all_s: float
) -> None:
    """Connections share the link; latency delays and does not throttle."""
    found = [times_s(text, num_bytes, connections) for _ in range(3)]
    assert min(one for one, _ in found) > 0.95 * first_s
    assert 0.95 * all_s < min(one for _, one in found) < all_s + 0.15


@pytest.mark.parametrize("megabits", [3, 12, 40, 100])
def test_nothing_is_acknowledged_before_it_has_passed(megabits: int) -> None:
    link = read_link(f"{megabits}M,50ms")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        with (
            LinkProcess(link, "127.0.0.1", port) as relay,
            socket.create_connection(relay.address, timeout=30) as player,
        ):
            connection, _ = listener.accept()
            with connection:
                player.setblocking(False)
                connection.setblocking(False)
                written = acked = 0
                began_s = relay.began_s
                assert began_s is not None
                while time.monotonic() < began_s + 0.5:
                    try:
                        written += connection.send(bytes(1 << 16))
                        player.recv(1 << 20)
                    except BlockingIOError:
                        select.select([player], [], [], 0.001)
                    acked = written - unacked_bytes(connection)
                    passed_bytes = link.capacity_bytes(0, time.monotonic() - began_s - 0.05)
                    # Bytes in the relay's kernel are acknowledged, too; they must be few.
                    assert acked <= passed_bytes + 0.02 * megabits * 1e6 / 8
                assert acked > 0


def test_small_answers_on_another_connection_take_no_time_of_the_link() -> None:
    num_bytes, latency_s, rate_bps = 120_000, 0.1, 1.6e6
    link = read_link("1600k,100ms")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        with (
            LinkProcess(link, "127.0.0.1", port) as relay,
            socket.create_connection(relay.address, timeout=30) as player,
            listener.accept()[0] as sender,
            socket.create_connection(relay.address, timeout=30) as asking,
            listener.accept()[0] as answering,
        ):
            sending = threading.Thread(target=sender.sendall, args=(bytes(num_bytes),))
            began_s = time.monotonic()
            sending.start()
            came = answers = 0
            player.settimeout(0.01)
            while came < num_bytes:
                if time.monotonic() > began_s + 0.05 * answers:
                    answering.sendall(b"ok")
                    answers += 1
                with contextlib.suppress(TimeoutError):
                    came += len(player.recv(1 << 16))
            took_s = time.monotonic() - began_s
            assert asking.recv(100).startswith(b"ok")
            sending.join()
    assert answers >= 10
    # Each extra round trip would have cost a latency.
    assert took_s == pytest.approx(latency_s + 8 * num_bytes / rate_bps, abs=0.15)


class Play:
    """A play of a real server over an emulated link, cut after `lasts_s`."""

    def __init__(self, root: Path, link: str, lasts_s: float, patch: pytest.MonkeyPatch) -> None:
        noted: Noted = []

        class NotingSession(PlaySession):
            """Records its state at every decision."""

            def decide(self, now_s: float) -> Decision:
                noted.append((time.monotonic(), self.rate_bps or 0.0, self.queued_bytes))
                return super().decide(now_s)

        patch.setattr(server.answers.play, "PlaySession", NotingSession)
        self._came: list[tuple[float, int]] = []
        asyncio.run(self._run(root, link, lasts_s))
        since_s, last_s = self._came[0][0] + SETTLED_S, self._came[-1][0]
        num_bytes = sum(num_bytes for time_s, num_bytes in self._came if time_s > since_s)
        self.goodput_bps = 8 * num_bytes / max(1e-6, last_s - since_s)
        settled = [one for one in noted if one[0] > since_s]
        self.estimate_bps = median([rate_bps for _, rate_bps, _ in settled] or [0.0])
        self.most_queued_bytes = max((queued for _, _, queued in settled), default=0.0)

    async def _run(self, root: Path, link: str, lasts_s: float) -> None:
        async with running(root, quick_config(max_lead_s=6.0)) as server:
            with LinkProcess(read_link(link), "127.0.0.1", server.port) as relay:
                await asyncio.to_thread(self._read, relay.address, lasts_s)

    def _read(self, address: tuple[str, int], lasts_s: float) -> None:
        with socket.create_connection(address, timeout=30) as client:
            client.sendall(b"GET /v1/streams/wide/play HTTP/1.0\r\nHost: x\r\n\r\n")
            until_s = time.monotonic() + lasts_s
            while time.monotonic() < until_s and (piece := client.recv(65536)):
                self._came.append((time.monotonic(), len(piece)))


def test_twelve_megabits_read_as_twelve(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    play = Play(root, "12M,20ms", SETTLED_S + 2, monkeypatch)
    assert play.goodput_bps == pytest.approx(12e6, rel=0.05)
    assert play.estimate_bps == pytest.approx(12e6, rel=0.05)


@pytest.mark.parametrize("megabits", [4, 12, 40, 100])
def test_no_more_than_a_quarter_second_is_unacknowledged(
    root: Path, monkeypatch: pytest.MonkeyPatch, megabits: int
) -> None:
    play = Play(root, f"{megabits}M,20ms", SETTLED_S + 0.4, monkeypatch)
    assert 0 < play.most_queued_bytes <= 0.25 * megabits * 1e6 / 8
