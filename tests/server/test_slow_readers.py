"""Slow readers get everything; readers that make no room for 60 s are cut, and logged as cut."""

from __future__ import annotations

import asyncio
import socket
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from fuzz.http import MemoryTransport
from server.clients.connection import ClientConnection, Clients
from server.clients.timeouts import TimeoutConfig
from server.exchange.exchange import Exchange
from server.operate.prometheus import Metrics
from server.operate.workers.supervisorconfig import SupervisorConfig
from server.state.config import ServerConfig
from tests.support.server.running_server import (
    eventually,
    make_stream,
    play,
    quick_config,
    running,
    served,
    slices_of,
)

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(sys.platform != "linux", reason="only Linux has the limit"),
]

OBJECT = "/v1/streams/wide/segments/0/0"
PLAY = "/v1/streams/wide/play?layers=4"
OBJECT_BYTES = 1_000_000


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    make_stream(folder / "wide", 5, slice_size=24_000)  # objects of over a megabyte
    make_stream(folder / "walk", 5, fps=300)
    return folder


@contextmanager
def asking(port: int, path: str, *lines: str) -> Iterator[socket.socket]:
    """A client that has sent a request, with an ordinary receive buffer and the segments of the
    internet, not of the loopback."""
    with socket.socket() as sock:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_MAXSEG, 1448)
        sock.connect(("127.0.0.1", port))
        sock.sendall("\r\n".join([f"GET {path} HTTP/1.1", "Host: h", *lines, "", ""]).encode())
        yield sock


async def test_connections_inherit_the_limit_of_the_kernel(root: Path) -> None:
    config = ServerConfig()
    async with served(root, config) as (server, client), client.get(PLAY) as response:
        (connection,) = server.server.connections
        sock = connection.transport.get_extra_info("socket")
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 60_000
        response.close()


class Unread(MemoryTransport):
    """A transport whose client takes only what the test takes."""

    def get_write_buffer_size(self) -> int:
        return len(self.sent)


class Written:
    """The part of aiohttp's writer that a connection reads."""

    output_size = OBJECT_BYTES


@pytest.mark.parametrize("rate", [1_200, 5_000, 10_000, 20_000])
@pytest.mark.anyio
async def test_nothing_else_cuts_whoever_makes_room_64_kb_at_a_time(rate: int) -> None:
    """As an ordinary receive buffer does, from the first byte of a response to its last."""
    with socket.socket(socket.AF_UNIX) as sock:  # not TCP: the kernel says nothing of it
        transport = Unread(sock)
        clients = Clients(asyncio.Protocol, lambda *_: None, TimeoutConfig(), Metrics())
        connection = ClientConnection(clients, "a", lambda _: None)
        connection.connection_made(transport)
        connection.begin(Written())  # type: ignore[arg-type]
        transport.write(bytes(OBJECT_BYTES))
        now_s, room_s = asyncio.get_running_loop().time(), 65_536 / rate
        for step in range(1, int(2 * OBJECT_BYTES / rate)):
            connection.check(now_s + 0.5 * step)
            if step % (2 * round(room_s)) == 0:
                del transport.sent[:65_536]
            assert not connection.cut, f"after {0.5 * step} s"
            assert not transport.is_closing()


@pytest.mark.parametrize("lines", [(), ("Connection: close",), ("Range: bytes=0-599999",)], ids=str)
@pytest.mark.parametrize("path", [PLAY, OBJECT])
async def test_a_reader_that_stops_is_cut_and_logged_as_cut(
    root: Path,
    path: str,
    lines: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Also where the kernel and the client's buffer hold all that is left of the response."""
    config = quick_config(write_timeout_s=0.3, keepalive_timeout_s=0.2)
    async with served(root, config) as (server, client):
        app, finished = server.server.app, list[Exchange]()
        finish = app.finished

        def note(exchange: Exchange, now_s: float) -> None:
            finish(exchange, now_s)
            finished.append(exchange)

        with monkeypatch.context() as patched, asking(server.port, path, *lines):
            patched.setattr(app, "finished", note)
            # Another client is served meanwhile.
            assert slices_of(await play(client, "walk", "?layers=1"))
            await eventually(lambda: len(finished) == 2)
            metrics = server.state.metrics
            assert metrics.timeouts.value("write") == 1
            (cut,) = (exchange for exchange in finished if exchange.status != 200)
            assert (cut.status, cut.facts["outcome"]) == (499, "stalled")
            assert metrics.plays.value("stalled") == ("play" in path)
            assert not len(server.state.plays)
    assert not caplog.records


async def test_the_server_ends_though_clients_read_nothing(root: Path) -> None:
    config = replace(quick_config(), supervisor=SupervisorConfig(shutdown_timeout_s=0.2))
    async with running(root, config) as server:
        connections = server.server.connections
        with asking(server.port, PLAY), asking(server.port, OBJECT):
            await eventually(lambda: len(server.state.plays) and len(connections) == 2)
            await server.server.stop()
        assert server.state.metrics.plays.value("stopped") == 1
        assert not connections


def read(port: int, rate: int, ended: threading.Event) -> tuple[int, float]:
    """Bytes that a reader of `rate` bytes a second gets, and after how many seconds it ends."""
    began_s, num_bytes = time.monotonic(), 0
    with asking(port, OBJECT, f"Range: bytes=0-{OBJECT_BYTES - 1}", "Connection: close") as sock:
        try:
            while not rate and not ended.wait(0.5):
                sock.sendall(b"")
                if sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                    raise ConnectionResetError
            while piece := sock.recv(min(16_384, max(1, rate))):
                num_bytes += len(piece)
                ended.wait(max(0.0, num_bytes / rate - (time.monotonic() - began_s)))
        except ConnectionError:
            pass
    return num_bytes, time.monotonic() - began_s


@pytest.mark.realtime
async def test_readers_of_5_kb_a_second_get_everything_and_those_of_2_end(root: Path) -> None:
    fast, slow = (5_000, 10_000, 20_000, 50_000), (16, 100, 500, 1_000, 2_000)

    async with running(root, ServerConfig()) as server:
        metrics, ended = server.state.metrics, threading.Event()
        with ThreadPoolExecutor(len(fast + slow)) as pool:
            readers = [pool.submit(read, server.port, rate, ended) for rate in fast + slow]
            stuck = asking(server.port, OBJECT)
            with stuck:
                async with asyncio.timeout(70):
                    await eventually(lambda: metrics.timeouts.value("write") == len(slow) + 1)
            for reader in readers[: len(fast)]:
                num_bytes, _ = await asyncio.wrap_future(reader)
                assert num_bytes > OBJECT_BYTES  # and its head
            assert metrics.timeouts.value("write") == len(slow) + 1
            ended.set()
