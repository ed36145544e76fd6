"""The relay in its process, on real sockets."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from player.link.linkprocess import LinkProcess
from player.link.linktext import read_link
from tests.support.suite.starved import Watch

pytestmark = pytest.mark.realtime


class Pouring:
    """Sends zeros on each connection: `num_bytes`, or until the connection ends."""

    def __init__(self, num_bytes: int | None) -> None:
        self._num_bytes = num_bytes
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 64 << 10)
        self.port: int = self._listener.getsockname()[1]
        self.sent_bytes = 0
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            self._threads.append(threading.Thread(target=self._pour, args=(connection,)))
            self._threads[-1].start()

    def _pour(self, connection: socket.socket) -> None:
        with connection:
            left = self._num_bytes
            try:
                while left is None or left > 0:
                    sent = connection.send(bytes(16384 if left is None else min(left, 16384)))
                    self.sent_bytes += sent
                    left = None if left is None else left - sent
            except OSError:
                return

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for thread in self._threads:
            thread.join()


@contextmanager
def pouring(num_bytes: int | None) -> Iterator[Pouring]:
    server = Pouring(num_bytes)
    try:
        yield server
    finally:
        server.close()


def drain(address: tuple[str, int]) -> int:
    with socket.create_connection(address, timeout=30) as connection:
        total = 0
        while piece := connection.recv(65536):
            total += len(piece)
        return total


def takes_s(
    text: str, num_bytes: int, work: Callable[[LinkProcess], object], least_s: float, most_s: float
) -> None:
    """Asserts the time of `work` over a link to a server that sends `num_bytes` per connection. It
    is never below `least_s`, and at most `most_s` in the best of five tries, because other work on
    the machine adds time."""
    starved = False
    for _ in range(5):
        with (
            pouring(num_bytes) as server,
            LinkProcess(read_link(text), "127.0.0.1", server.port) as relay,
            Watch() as watch,
        ):
            began_s = time.monotonic()
            work(relay)
            took_s = time.monotonic() - began_s
        assert took_s > least_s
        if took_s < most_s:
            return
        starved = starved or watch.starved
    if starved:
        pytest.skip("the machine is too busy for times to say anything")
    pytest.fail(f"took {took_s:.3f} s, not under {most_s} s")


def test_one_second_of_bytes_takes_a_second() -> None:
    def pour(relay: LinkProcess) -> None:
        assert drain(relay.address) == 1_000_000
        assert relay.down_bytes == 1_000_000

    takes_s("8M", 1_000_000, pour, 0.95, 1.1)


def test_connections_share_the_link() -> None:
    def pour(relay: LinkProcess) -> None:
        threads = [threading.Thread(target=drain, args=(relay.address,)) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert relay.down_bytes == 600_000

    takes_s("8M", 150_000, pour, 0.57, 0.7)


def test_latency_delays_and_does_not_throttle() -> None:
    def pour(relay: LinkProcess) -> None:
        began_s = time.monotonic()
        with socket.create_connection(relay.address, timeout=30) as connection:
            total = len(connection.recv(1))
            assert time.monotonic() - began_s > 0.145
            while piece := connection.recv(65536):
                total += len(piece)
        assert total == 1_000_000

    takes_s("40M,150ms", 1_000_000, pour, 0.34, 0.5)


def test_a_player_that_does_not_read_holds_the_server_back() -> None:
    with (
        pouring(None) as server,
        LinkProcess(read_link("1G"), "127.0.0.1", server.port) as relay,
        socket.socket() as connection,
    ):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 64 << 10)
        connection.connect(relay.address)
        sent_bytes, since_s = -1, time.monotonic()
        while server.sent_bytes != sent_bytes and time.monotonic() - since_s < 10:
            sent_bytes = server.sent_bytes
            time.sleep(0.3)
        assert sent_bytes == server.sent_bytes
        assert 0 < sent_bytes < 2 << 20


def test_a_server_that_is_away_is_said_in_http() -> None:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    with LinkProcess(read_link("8M"), "127.0.0.1", port) as relay:
        with socket.create_connection(relay.address, timeout=10) as connection:
            connection.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
            answer = b""
            while piece := connection.recv(65536):
                answer += piece
        assert answer.startswith(b"HTTP/1.1 502")
        assert b"cannot connect" in answer


def test_closing_the_relay_cuts_its_connections() -> None:
    with pouring(None) as server:
        relay = LinkProcess(read_link("100k"), "127.0.0.1", server.port)
        with socket.create_connection(relay.address, timeout=10) as connection:
            assert connection.recv(1)
            relay.close()
            relay.close()
            with contextlib.suppress(ConnectionError):
                while connection.recv(65536):
                    pass
