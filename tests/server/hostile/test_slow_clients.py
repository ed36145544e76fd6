"""Many slow clients cost the server little memory, and others are served meanwhile. That they are
cut stands in tests/server/http and tests/server/test_slow_readers.py."""

from __future__ import annotations

import socket
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.support.hosted_streams import write_stream
from tests.support.hostile import within_bytes
from tests.support.server.running_server import eventually, fetch, served

NUM_CLIENTS = 200


def connect(stack: ExitStack, port: int, number: int, sent: bytes) -> None:
    """Connects a client that reads nothing, from one of many addresses of the loopback, so that a
    limit per address does not help."""
    sock = stack.enter_context(socket.socket())
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    sock.bind((f"127.0.1.{1 + number % 250}", 0))
    sock.connect(("127.0.0.1", port))
    sock.sendall(sent)


@pytest.mark.anyio
@pytest.mark.skipif(sys.platform != "linux", reason="many addresses of the loopback: Linux")
async def test_heads_without_an_end_and_bodies_that_nobody_reads_take_little(
    tmp_path: Path,
) -> None:
    path = write_stream(tmp_path / "big", 1, slice_size=14_000, layers=(1.0,))
    size_bytes = (path / "segments/0/keyframe-0").stat().st_size
    assert size_bytes > 4 << 20  # it fits into no buffer of a socket
    head = b"GET /v1/streams/big/segments/0/keyframe-0 HTTP/1.1\r\nHost: h\r\n\r\n"
    async with served(tmp_path) as (server, client):
        hits = server.state.metrics.cache_hits
        await (await client.get("/v1/streams/big/segments/0/keyframe-0")).read()
        with ExitStack() as stack, within_bytes(24 << 20):
            for number in range(NUM_CLIENTS):
                connect(stack, server.port, number, head if number % 2 else head[:-3])
            await eventually(lambda: hits.value() == NUM_CLIENTS // 2)
            assert server.state.connections.num_held == NUM_CLIENTS + 1
            assert (await fetch(client, "/healthz")).status == 200
