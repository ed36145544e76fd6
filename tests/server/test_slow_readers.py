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

from server.operate.workers import SupervisorConfig
from server.state.config import ServerConfig
from tests.support.server.plain_site import in_memory
from tests.support.server.running_server import (
    eventually,
    make_stream,
    play,
    quick_config,
    running,
    served,
    slices_of,
)
from tests.support.server.virtualtime import in_virtual_time, passes

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
        assert connection.transport is not None
        sock = connection.transport.get_extra_info("socket")
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 60_000
        response.close()


@pytest.mark.parametrize("rate", [1_200, 5_000, 10_000, 20_000])
@in_virtual_time
async def test_nothing_else_cuts_whoever_makes_room_64_kb_at_a_time(root: Path, rate: int) -> None:
    """As an ordinary receive buffer does, from the first byte of a response to its last."""
    async with in_memory(root) as (connection, transport, _, log):
        connection.data_received(f"GET {OBJECT} HTTP/1.1\r\nHost: h\r\n\r\n".encode())
        taken_bytes = 0
        while not log.kept:
            assert not connection.cut
            assert not transport.is_closing()
            taken_bytes += min(65_536, len(transport.sent))
            transport.take(65_536)
            await passes(65_536 / rate)
        assert taken_bytes > OBJECT_BYTES - 65_536
        assert log.kept[0]["status"] == 200


@pytest.mark.parametrize("lines", [(), ("Connection: close",), ("Range: bytes=0-599999",)], ids=str)
@pytest.mark.parametrize("path", [PLAY, OBJECT])
async def test_a_reader_that_stops_is_cut_and_logged_as_cut(
    root: Path,
    path: str,
    lines: tuple[str, ...],
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Also where the kernel and the client's buffer hold all that is left of the response."""
    config = quick_config(write_timeout_s=0.3, keepalive_timeout_s=0.2)
    async with served(root, config) as (server, client):
        with asking(server.port, path, *lines):
            # Another client is served meanwhile.
            assert slices_of(await play(client, "walk", "?layers=1"))
            await eventually(lambda: len(server.log.kept) == 2)
            metrics = server.state.metrics
            assert metrics.timeouts.value("write") == 1
            (cut,) = (line for line in server.log.kept if line["status"] != 200)
            assert (cut["status"], cut["outcome"]) == (499, "stalled")
            assert metrics.plays.value("stalled") == ("play" in path)
            assert not len(server.state.plays)
    assert not caplog.records


async def test_the_server_ends_though_clients_read_nothing(root: Path) -> None:
    config = replace(quick_config(), supervisor=SupervisorConfig(shutdown_timeout_s=0.2))
    async with running(root, config) as server:
        with asking(server.port, PLAY), asking(server.port, OBJECT):
            plays = server.state.plays
            await eventually(lambda: len(plays) and server.state.connections.num_held == 2)
            await server.server.stop()
        assert server.state.metrics.plays.value("stopped") == 1
        assert [line["status"] for line in server.log.kept] == [499, 499]
        assert not server.state.connections.num_held


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
