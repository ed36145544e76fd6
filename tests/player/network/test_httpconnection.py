"""Connecting over real sockets, given up at any moment of it."""

from __future__ import annotations

import asyncio
import gc
import socket
import time
from collections.abc import Iterator
from contextlib import closing, suppress

import pytest

from player.network.httpconnection import HttpConnection, Target


@pytest.fixture
def without_collector() -> Iterator[None]:
    """What is forgotten stays open, as it does until a collector happens to run."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.mark.usefixtures("without_collector")
@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
@pytest.mark.parametrize("num_turns", range(8))
def test_a_connection_that_is_given_up_is_closed(host: str, num_turns: int) -> None:
    """A host would wait for its request as long as it waits for anybody's."""
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:
        target = Target.of(f"http://{host}:{listener.getsockname()[1]}/")
        give_up_after(num_turns, target)
        listener.settimeout(0.2)
        try:
            connection, _ = listener.accept()
        except TimeoutError:
            return  # given up before there was one
        with connection:
            connection.settimeout(5)
            with suppress(ConnectionResetError):
                assert connection.recv(1) == b""


def give_up_after(num_turns: int, target: Target) -> None:
    """Cancels what connects after so many turns of a loop, which then turns once more."""

    async def close(connection: asyncio.Task[HttpConnection]) -> None:
        connection.cancel()
        with suppress(asyncio.CancelledError):
            (await connection).close()

    loop = asyncio.new_event_loop()
    connecting = loop.create_task(HttpConnection.open(target, 5))
    for _ in range(num_turns):
        loop.run_until_complete(asyncio.sleep(0))
        time.sleep(0.002)  # for the kernel, and for whoever looks up the name
    loop.run_until_complete(close(connecting))
    loop.run_until_complete(asyncio.sleep(0))
    loop.close()
