"""The link as numbers, and the relay on real sockets."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.link.link import Link, LinkStep
from player.link.relay import Relay

steps = st.lists(
    st.builds(
        LinkStep,
        st.floats(0.01, 5),
        st.one_of(st.just(0.0), st.floats(1e3, 1e8)),
        st.floats(0, 0.2),
    ),
    min_size=1,
    max_size=6,
).filter(lambda s: any(step.rate_bps for step in s))


def bits_between(link: Link, start_s: float, end_s: float) -> float:
    """What the link passes from `start_s` to `end_s`, summed up step by step."""
    total, at_s, n = 0.0, 0.0, 0
    while at_s < end_s:
        step = link.steps[n % len(link.steps)]
        over_s = min(end_s, at_s + step.duration_s) - max(start_s, at_s)
        total += step.rate_bps * max(0.0, over_s)
        at_s += step.duration_s
        n += 1
    return total


@given(steps, st.floats(0, 20), st.integers(0, 100_000))
def test_bytes_take_as_long_as_the_steps_say(
    steps: list[LinkStep], start_s: float, num_bytes: int
) -> None:
    link = Link(steps)
    # Not more than a few rounds of the trace: the sum above is slow.
    num_bytes = min(num_bytes, int(bits_between(link, start_s, start_s + 100) / 8))
    end_s = link.passed_s(start_s, num_bytes)
    assert end_s >= start_s
    assert bits_between(link, start_s, end_s) == pytest.approx(8 * num_bytes, rel=1e-6, abs=20)


@given(steps, st.floats(0, 9), st.integers(0, 9999), st.integers(0, 9999))
def test_two_pieces_take_as_long_as_one(
    steps: list[LinkStep], start_s: float, first: int, second: int
) -> None:
    link = Link(steps)
    after_s = link.passed_s(link.passed_s(start_s, first), second)
    bits = bits_between(link, start_s, after_s)
    assert bits == pytest.approx(8 * (first + second), rel=1e-6, abs=40)


def test_links_as_text(tmp_path: Path) -> None:
    assert Link.parse("8M").at(5).rate_bps == 8e6
    assert Link.parse("1.5G").at(0).rate_bps == 1.5e9
    assert Link.parse("64k,20ms").at(1e6) == LinkStep(3600.0, 64e3, 0.02)
    trace = tmp_path / "trace.json"
    entry = {"duration_ms": 500, "bandwidth_kbps": 2000, "latency_ms": 30.5}
    trace.write_text(json.dumps([entry, {**entry, "bandwidth_kbps": 0}]))
    link = Link.parse(str(trace))
    assert link.steps[0] == LinkStep(0.5, 2e6, 0.0305)
    # 0.5 s at 2 Mbit/s is 125 kB; the next half second passes nothing, then the trace repeats.
    assert link.passed_s(0, 125_000) == pytest.approx(0.5)
    assert link.passed_s(0, 250_000) == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fast", "neither a rate"),
        ("8M,20", "neither a rate"),
        ("0", "nothing ever passes"),
        ("-8M", "neither a rate"),
        ("nowhere.json", "No such file"),
    ],
)
def test_bad_links(text: str, message: str) -> None:
    with pytest.raises(InvalidError, match=message):
        Link.parse(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[", "not JSON"),
        ("{}", "not a list of steps"),
        ('[{"duration_ms": 5}]', "step 0 does not hold"),
        ('[{"duration_ms": 0, "bandwidth_kbps": 5, "latency_ms": 5}]', "step 0"),
        ('[{"duration_ms": 5, "bandwidth_kbps": NaN, "latency_ms": 5}]', "step 0"),
        ('[{"duration_ms": 5, "bandwidth_kbps": 0, "latency_ms": 5}]', "nothing ever passes"),
        ('[{"duration_ms": 1e300, "bandwidth_kbps": 1e300, "latency_ms": 5}]', "too large"),
    ],
)
def test_bad_traces(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "trace.json").write_text(text)
    with pytest.raises(InvalidError, match=message):
        Link.parse(str(tmp_path / "trace.json"))


class Pouring:
    """Sends zeros to whoever connects: `num_bytes`, or until the connection ends."""

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


def takes_s(work: Callable[[], object], least_s: float, most_s: float) -> None:
    """Never less, and not more in the best of five tries: other work on the machine adds time."""
    for attempt in range(5):
        began_s = time.monotonic()
        work()
        took_s = time.monotonic() - began_s
        assert took_s > least_s
        if took_s < most_s:
            return
        time.sleep(attempt)
    pytest.fail(f"took {took_s:.3f} s, not under {most_s} s")


def test_one_second_of_bytes_takes_a_second() -> None:
    def pour() -> None:
        link = Link.parse("8M")
        with pouring(1_000_000) as server, Relay(link, "127.0.0.1", server.port) as relay:
            assert drain(relay.address) == 1_000_000
            assert relay.down_bytes == 1_000_000

    takes_s(pour, 0.9, 1.1)


def test_connections_share_the_link() -> None:
    def pour() -> None:
        link = Link.parse("8M")
        with pouring(150_000) as server, Relay(link, "127.0.0.1", server.port) as relay:
            threads = [threading.Thread(target=drain, args=(relay.address,)) for _ in range(4)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            assert relay.down_bytes == 600_000

    takes_s(pour, 0.54, 0.66)


def test_latency_delays_and_does_not_throttle() -> None:
    def pour() -> None:
        link = Link.parse("40M,150ms")
        with pouring(1_000_000) as server, Relay(link, "127.0.0.1", server.port) as relay:
            began_s = time.monotonic()
            with socket.create_connection(relay.address, timeout=30) as connection:
                total = len(connection.recv(1))
                assert time.monotonic() - began_s > 0.14
                while piece := connection.recv(65536):
                    total += len(piece)
            assert total == 1_000_000

    takes_s(pour, 0.3, 0.45)


def test_a_player_that_does_not_read_holds_the_server_back() -> None:
    with (
        pouring(None) as server,
        Relay(Link.parse("1G"), "127.0.0.1", server.port) as relay,
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
    with Relay(Link.parse("8M"), "127.0.0.1", port) as relay:
        with socket.create_connection(relay.address, timeout=10) as connection:
            connection.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
            answer = b""
            while piece := connection.recv(65536):
                answer += piece
        assert answer.startswith(b"HTTP/1.1 502")
        assert b"cannot connect" in answer


def test_closing_the_relay_cuts_its_connections() -> None:
    with pouring(None) as server:
        relay = Relay(Link.parse("100k"), "127.0.0.1", server.port)
        with socket.create_connection(relay.address, timeout=10) as connection:
            assert connection.recv(1)
            relay.close()
            relay.close()
            with contextlib.suppress(ConnectionError):
                while connection.recv(65536):
                    pass
            assert relay.down_bytes < 100_000
