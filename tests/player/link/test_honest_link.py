"""A server sees the emulated link like a real one."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time
from pathlib import Path
from statistics import median

import pytest

import server.answers.play
from player.link.linkprocess import LinkProcess
from player.link.linktext import read_link
from server.abr.session import Decision, PlaySession
from server.exchange.tcpinfo import unacked_bytes
from tests.support.server.running_server import make_stream, quick_config, running
from tests.support.suite.starved import Watch

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
                        time.sleep(0.001)
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
        with Watch() as watch:
            asyncio.run(self._run(root, link, lasts_s))
        self.starved = watch.starved
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


@pytest.mark.quiet
def test_twelve_megabits_read_as_twelve(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    starved = False
    for _ in range(5):  # other work on the machine reduces the bytes that pass
        play = Play(root, "12M,20ms", SETTLED_S + 2, monkeypatch)
        told = (play.goodput_bps, play.estimate_bps)
        if all(abs(rate_bps / 12e6 - 1) < 0.05 for rate_bps in told):
            return
        starved = starved or play.starved
    if starved:
        pytest.skip("the machine is too busy for rates to say anything")
    pytest.fail(f"12 Mbit/s read as {told}")


@pytest.mark.quiet
@pytest.mark.parametrize("megabits", [4, 12, 40, 100])
def test_no_more_than_a_quarter_second_is_unacknowledged(
    root: Path, monkeypatch: pytest.MonkeyPatch, megabits: int
) -> None:
    play = Play(root, f"{megabits}M,20ms", SETTLED_S + 0.4, monkeypatch)
    if play.starved:
        pytest.skip("the machine is too busy for a latency to be known")
    assert 0 < play.most_queued_bytes <= 0.25 * megabits * 1e6 / 8
