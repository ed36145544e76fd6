"""Answers over sockets: as they stand in the specification, cut, kept, and not HTTP at all."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from player.network.faults import BrokenError, FetchError
from player.network.fetch import FetchConfig, Fetcher
from player.network.httpconnection import Target

BODY = bytes(range(256)) * 900


class Host:
    """Gives each request the next of `answers`; closes the connection after one that says so."""

    def __init__(self, *answers: bytes) -> None:
        self._answers = list(answers)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}/a"
        self.requests: list[bytes] = []
        self.num_connections = 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while self._answers:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            self.num_connections += 1
            with connection:
                while self._answers and (request := self._request(connection)):
                    self.requests.append(request)
                    answer = self._answers.pop(0)
                    connection.sendall(answer)
                    if b"close" in answer[:200] or answer.startswith(b"HTTP/1.0"):
                        break

    def _request(self, connection: socket.socket) -> bytes:
        request = b""
        while b"\r\n\r\n" not in request:
            piece = connection.recv(65536)
            if not piece:
                return b""
            request += piece
        return request

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(5)


@contextmanager
def asked(*answers: bytes) -> Iterator[tuple[Host, Fetcher]]:
    config = FetchConfig(connect_timeout_s=2.0, idle_s=2.0)
    with closing(Host(*answers)) as host, closing(Fetcher(config=config)) as fetcher:
        yield host, fetcher


def sized(body: bytes, more: str = "") -> bytes:
    return f"HTTP/1.1 200 OK\r\nContent-Length: {len(body)}\r\n{more}\r\n".encode() + body


def chunked(body: bytes, size: int) -> bytes:
    pieces = [body[at : at + size] for at in range(0, len(body), size)]
    chunks = b"".join(b"%x\r\n%s\r\n" % (len(piece), piece) for piece in pieces)
    return b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n" + chunks + b"0\r\n\r\n"


@pytest.mark.parametrize(
    "answer",
    [
        sized(BODY),
        chunked(BODY, 1000),
        b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n" + BODY,
        b"HTTP/1.0 200 OK\r\n\r\n" + BODY,
        b"HTTP/1.1 100 Continue\r\n\r\n" + sized(BODY, "Connection: close\r\n"),
    ],
)
def test_bodies_come_whole(answer: bytes) -> None:
    with asked(answer) as (host, fetcher):
        response = fetcher.get(host.url, len(BODY))
    assert response.status == 200
    assert response.body == BODY


def test_one_connection_serves_many_requests() -> None:
    with asked(sized(b"one"), chunked(b"two", 2), sized(b"three")) as (host, fetcher):
        bodies = [fetcher.get(host.url, 10).body for _ in range(3)]
        assert host.num_connections == 1
    assert bodies == [b"one", b"two", b"three"]


def test_a_connection_that_the_host_closed_meanwhile_is_replaced() -> None:
    answers = [sized(b"one"), sized(b"two", "Connection: close\r\n"), sized(b"three")]
    with asked(*answers) as (host, fetcher):
        bodies = [fetcher.get(host.url, 10).body for _ in range(3)]
        assert host.num_connections == 2
    assert bodies == [b"one", b"two", b"three"]


def test_one_that_was_not_read_to_its_end_is_not_used_again() -> None:
    with asked(sized(BODY), sized(b"two")) as (host, fetcher):
        with closing(fetcher.open(host.url)) as response:
            assert response.read(1.0)
        assert fetcher.get(host.url, 10).body == b"two"
        assert host.num_connections == 2


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (sized(BODY)[:-1], "the connection broke"),
        (chunked(BODY, 1000)[:-5], "the connection broke"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: -4\r\n\r\n", "the connection broke"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 4\r\nContent-Length: 5\r\n\r\n", "broke"),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: gzip\r\n\r\n", "the connection broke"),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n", "the connection broke"),
        (b"ICY 200 OK\r\n\r\n", "the connection broke"),
        (b"\x00" * 100_000, "the connection broke"),
        (b"HTTP/1.1 200 OK\r\nX: " + b"x" * 1_000_000, "the connection broke"),
        (b"", "the connection broke"),
    ],
)
def test_what_is_not_an_answer_is_an_error(answer: bytes, message: str) -> None:
    with asked(answer) as (host, fetcher), pytest.raises(BrokenError, match=message):
        fetcher.get(host.url, 1 << 30)


@given(st.binary(max_size=300))
def test_any_answer_gives_a_value_or_an_error(junk: bytes) -> None:
    with (
        asked(b"HTTP/1.0 200 OK\r\n" + junk) as (host, fetcher),
        suppress(FetchError),
    ):
        fetcher.get(host.url, 1 << 20)


def test_who_does_not_listen_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with closing(Fetcher()) as fetcher:
        for host in ("127.0.0.1", "localhost"):
            with pytest.raises(
                BrokenError, match=f"{host}:{port}/a: cannot connect: Connection ref"
            ):
                fetcher.get(f"http://{host}:{port}/a", 10)


def test_a_name_that_nobody_has_is_told() -> None:
    with closing(Fetcher()) as fetcher, pytest.raises(BrokenError, match="cannot connect: "):
        fetcher.get("http://nobody.invalid/a", 10)


@pytest.mark.parametrize(
    "url",
    [
        "http://",
        "ftp://a/b",
        "http://a:b/",
        "http://a:99999/",
        "http://é..é/",
        "http://a..b/",
        "http://a b/",
        "http://" + "a" * 70,
    ],
)
def test_what_is_not_a_url_is_told(url: str) -> None:
    with closing(Fetcher()) as fetcher, pytest.raises(FetchError, match="is not a URL"):
        fetcher.get(url, 10)


def test_targets() -> None:
    plain = Target.of("http://Host:80/a b/%20ü?q=x y#part")
    assert plain.path == b"/a%20b/%20%C3%BC?q=x%20y"
    assert plain.host_field == "host"
    named = Target.of("https://me:p%40ss@[::1]:8443")
    assert (named.host, named.port, named.path) == ("::1", 8443, b"/")
    assert named.host_field == "[::1]:8443"
    assert named.authorization == "Basic bWU6cEBzcw=="
    assert Target.of("http://bücher.example/").host_field == "xn--bcher-kva.example"
