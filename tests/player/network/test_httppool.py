"""Requests over sockets that are kept, cut or abandoned; valid and invalid HTTP responses; failures
of TLS, which say their cause and are not tried again."""

from __future__ import annotations

import asyncio
import gc
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from player.network.fetch import Fetcher, FetchError
from player.network.http import MAX_IDLE, HttpPool
from player.network.target import BrokenError, Target
from tests.player.network.webhosts import ScriptedHost, script, web_host
from tests.support.commands import environment, run, serving, unhurried
from tests.support.ports import kept_port
from tests.support.waiting import BOUND_S

BODY = bytes(range(256)) * 900


@contextmanager
def asked(*answers: bytes) -> Iterator[tuple[ScriptedHost, Fetcher]]:
    with script(*answers) as host, closing(Fetcher()) as fetcher:
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


@pytest.mark.parametrize(
    ("answers", "connections"),
    [
        ((sized(b"one"), chunked(b"two", 2)), 1),
        ((sized(b"one", "Connection: close\r\n"), sized(b"two")), 2),
        ((sized(b"one"), b"", sized(b"two")), 2),  # closed only after the next request has arrived
    ],
)
def test_a_connection_serves_many_requests_and_is_replaced_once_the_host_closed_it(
    answers: tuple[bytes, ...], connections: int
) -> None:
    with asked(*answers) as (host, fetcher):
        assert [fetcher.get(host.url, 10).body for _ in range(2)] == [b"one", b"two"]
        assert host.num_connections == connections


def test_one_that_was_not_read_to_its_end_is_not_used_again() -> None:
    with asked(sized(BODY), sized(b"two")) as (host, fetcher):
        with closing(fetcher.open(host.url)) as response:
            assert response.read(1.0)
        assert fetcher.get(host.url, 10).body == b"two"
        assert host.num_connections == 2
    with (
        asked(b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n" + BODY) as (host, fetcher),
        pytest.raises(FetchError, match="longer than 100 bytes"),
    ):
        fetcher.get(host.url, 100)


@pytest.mark.parametrize(
    "answer",
    [
        sized(BODY)[:-1],
        chunked(BODY, 1000)[:-5],
        b"HTTP/1.1 200 OK\r\nContent-Length: -4\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nContent-Length: 4\r\nContent-Length: 5\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: gzip\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
        b"ICY 200 OK\r\n\r\n",
        b"\x00" * 100_000,
        b"HTTP/1.1 200 OK\r\nX: " + b"x" * 1_000_000,
        b"",
    ],
)
def test_what_is_not_an_answer_is_an_error(answer: bytes) -> None:
    with asked(answer) as (host, fetcher), pytest.raises(BrokenError, match="connection broke"):
        fetcher.get(host.url, 1 << 30)


@settings(max_examples=25)
@given(st.binary(max_size=300))
def test_any_answer_gives_a_value_or_an_error(junk: bytes) -> None:
    with asked(b"HTTP/1.0 200 OK\r\n" + junk) as (host, fetcher), suppress(FetchError):
        fetcher.get(host.url, 1 << 20)


def test_a_host_that_cannot_be_reached_is_named() -> None:
    port = kept_port()
    bad = ["http://[", "http:///x", "http://[::1/s", "ftp://a/b", "http://a:b/", "http://a:99999/"]
    bad += ("http://", "http://é..é/", "http://a..b/", "http://a b/", "http://" + "a" * 70)
    with closing(Fetcher()) as fetcher:
        for host in ("http://127.0.0.1", "http://localhost", "https://localhost"):
            message = f"{host}:{port}/a: cannot connect: Connection refused"
            with pytest.raises(BrokenError, match=message):
                fetcher.get(f"{host}:{port}/a", 10)
        with pytest.raises(BrokenError, match=r"cannot connect: .*[Nn]ame"):
            fetcher.get("http://nobody.invalid/a", 10)
        for url in bad:
            with pytest.raises(FetchError, match="is not a URL"):
                fetcher.get(url, 10)


def test_few_idle_connections_are_kept(folder: Path) -> None:
    with web_host(folder) as host, closing(Fetcher()) as fetcher:
        url = f"http://127.0.0.1:{host.server_port}/s/manifest.json"
        asked = [fetcher.ask(url, {}, 1 << 20) for _ in range(MAX_IDLE + 3)]
        while not all(one.ended for one in asked):
            fetcher.wait(1.0)
        assert [one.error for one in asked] == [None] * (MAX_IDLE + 3)
        assert host.num_connections == MAX_IDLE + 3
        while host.num_open > MAX_IDLE:
            fetcher.pause(0.01)
        assert host.num_open == MAX_IDLE
        assert fetcher.get(url, 1 << 20).status == 200
        assert host.num_connections == MAX_IDLE + 3
        for one in asked:
            one.close()


def test_every_address_of_a_host_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    looked_up = socket.getaddrinfo

    def several(host: str | bytes | None, *args: Any, **options: Any) -> list[Any]:
        if host not in ("several.example", b"several.example"):
            return looked_up(host, *args, **options)
        kind = (socket.AF_INET, socket.SOCK_STREAM, 6, "")
        return [(*kind, (address, 0)) for address in ("127.0.0.2", "127.0.0.1")]

    monkeypatch.setattr(socket, "getaddrinfo", several)
    with asked(sized(b"one")) as (host, fetcher):
        url = host.url.replace("127.0.0.1", "several.example")
        assert fetcher.get(url, 10).body == b"one"


def test_a_play_without_a_network_does_not_load_httpcore(folder: Path, tmp_path: Path) -> None:
    code = (
        "import sys, player.__main__ as command\n"
        f"sys.argv = ['swings-play', {str(folder / 's')!r}, '--capture', 'out.mp4']\n"
        "sys.argv += ['--renderer', 'cpu']\n"
        "command.main()\n"
        "assert 'player.network.fetch' in sys.modules\n"
        "assert not {'httpcore', 'anyio', 'urllib.request'} & set(sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
    )
    assert (done.returncode, unhurried(done.stderr)) == (0, "")


def test_targets() -> None:
    plain = Target.of("http://Host:80/a b/%20ü?q=x y#part")
    assert plain.path == "/a%20b/%20%C3%BC?q=x%20y"
    assert plain.host_field == "host"
    named = Target.of("https://me:p%40ss@[::1]:8443")
    assert (named.origin, named.path) == (("https", "::1", 8443), "/")
    assert named.host_field == "[::1]:8443"
    assert named.authorization == "Basic bWU6cEBzcw=="
    assert Target.of("http://bücher.example/").host_field == "xn--bcher-kva.example"


@pytest.mark.parametrize("host", ["http://127.0.0.1", "http://localhost", "https://127.0.0.1"])
@pytest.mark.parametrize("num_turns", range(0, 8, 2))
def test_a_connection_that_is_given_up_is_closed(host: str, num_turns: int) -> None:
    """Otherwise a host would wait for its request until its timeout."""
    pool = HttpPool(5)
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:
        target = Target.of(f"{host}:{listener.getsockname()[1]}/")
        gc.disable()  # it would close abandoned connections, as closing the pool would
        try:
            request = pool.loop.create_task(pool.request("GET", target, {}))
            for _ in range(num_turns):
                # A moment for the kernel, and for the thread that resolves the name.
                pool.loop.run_until_complete(asyncio.wait([request], timeout=0.002))
            request.cancel()
            pool.loop.run_until_complete(asyncio.wait([request]))
            pool.loop.close()
            listener.settimeout(0.2)
            with suppress(TimeoutError, ConnectionResetError):  # it may be given up before
                connection, _ = listener.accept()
                with connection:
                    connection.settimeout(BOUND_S)
                    while connection.recv(65536):  # the request, if it was sent
                        pass
        finally:
            gc.enable()


def test_a_certificate_that_is_not_trusted_or_of_another_host(
    folder: Path, certificate: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with web_host(folder, certificate) as host:
        url = f"https://localhost:{host.server_port}/s"
        words = ("--capture", tmp_path / "out.mp4", "--renderer", "cpu")
        done = run("swings-play", url, *words)
        assert done.returncode == 1
        assert done.stderr == (
            f"swings-play: {url}/manifest.json: its certificate is not trusted: self-signed "
            "certificate; if you trust it, name a file with its certificate in SSL_CERT_FILE\n"
        )
        assert host.num_connections == 1
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate[0]))
        trusted = run("swings-play", url, *words)
        assert (trusted.returncode, trusted.stderr) == (0, "")


def test_tls_where_plain_http_is_spoken_and_the_reverse(
    folder: Path, certificate: tuple[Path, Path]
) -> None:
    """Servers of three kinds speak TLS; the last one answers with an alert, like OpenSSL."""
    cert, key = certificate
    with web_host(folder) as host, closing(Fetcher()) as fetcher:
        with pytest.raises(FetchError, match="does not speak TLS at this port; try http://") as it:
            fetcher.get(f"https://127.0.0.1:{host.server_port}/s", 1000)
        assert not isinstance(it.value, BrokenError)
    with (
        closing(Fetcher()) as fetcher,
        serving(folder, "--tls-cert", cert, "--tls-key", key) as served,
        web_host(folder, certificate) as host,
        script(b"\x15\x03\x01\x00\x02\x02\x46") as alert,
    ):
        own = served.replace("https://", "http://")
        for url in (own, f"http://127.0.0.1:{host.server_port}/s", alert.url):
            with pytest.raises(BrokenError, match="if the server speaks TLS, use https://"):
                fetcher.get(url, 1000)


def test_a_handshake_that_is_cut_off_may_be_tried_again() -> None:
    with (
        script(b"") as host,
        closing(Fetcher()) as fetcher,
        pytest.raises(BrokenError, match="cannot connect: ") as broken,
    ):
        fetcher.get(host.url.replace("http://", "https://"), 1000)
    assert "not permitted" not in str(broken.value)
