"""Connections over real sockets and TLS: the order of responses, whole bodies, and their end."""

from __future__ import annotations

import asyncio
import random
import re
import socket
import ssl
from pathlib import Path

import pytest

from fuzz.http import MemoryTransport
from server.app import Application
from server.clients.connection import ClientConnection
from server.exchange.exchange import Exchange
from server.exchange.response import AnyResponse, BodyWriter, Response, StreamedResponse
from server.library import Library
from server.state.config import ServerConfig
from server.state.serverstate import ServerState
from tests.support.server.certificates import make_certificate
from tests.support.server.plain_site import Answers, on_site, text
from tests.support.server.running_server import eventually
from tests.support.server.virtualtime import in_virtual_time, now_s, passes

pytestmark = pytest.mark.anyio


def echo(exchange: Exchange) -> Response:
    assert exchange.request is not None
    return Response(200, {}, exchange.request.query.encode() + exchange.request.body)


async def late(exchange: Exchange) -> AnyResponse:
    await passes(0)
    return echo(exchange)


def chunks(exchange: Exchange) -> StreamedResponse:
    async def produce(writer: BodyWriter) -> None:
        for word in (b"some ", b"", b"words"):
            await writer.write(word)

    return StreamedResponse({}, produce)


ANSWERS: Answers = {
    "/ok": text(),
    "/echo": echo,
    "/late": late,
    "/chunks": chunks,
    "/large": text(body=bytes(range(256)) * 4096),
    "/304": text(304, b""),
}


async def test_a_hundred_requests_in_pieces_are_answered_in_order() -> None:
    paths = ["/echo", "/late", "/echo", "/chunks"]
    sent = "".join(f"GET {paths[n % 4]}?{n} HTTP/1.1\r\nHost: h\r\n\r\n" for n in range(100))
    async with on_site(ANSWERS) as site, site.connect() as client:
        for start in range(0, len(sent), 7):
            client.send(sent[start : start + 7].encode())
            await passes(0)
        for n in range(100):
            expected = b"some words" if n % 4 == 3 else str(n).encode()
            assert (await client.answer())[::2] == (200, expected)
    assert len(site.done) == 100


@pytest.mark.parametrize(
    ("path", "version", "line", "field", "kept"),
    [
        ("/ok", "1.1", "X: y", None, True),
        ("/304", "1.1", "X: y", None, True),
        ("/chunks", "1.1", "X: y", None, True),
        ("/ok", "1.1", "Connection: close", "close", False),
        ("/ok", "1.0", "X: y", "close", False),
        ("/ok", "1.0", "Connection: keep-alive", "keep-alive", True),
        ("/chunks", "1.0", "Connection: keep-alive", None, False),  # its end is the end of the body
    ],
)
async def test_a_connection_is_kept_where_both_want_it(
    path: str, version: str, line: str, field: str | None, kept: bool
) -> None:
    async with on_site(ANSWERS) as site, site.connect() as client:
        client.get(path, line, version=version)
        _, fields, body = await client.answer()
        assert fields.get("connection") == field
        assert path != "/chunks" or body == b"some words"
        client.get("/echo?again")
        assert (await client.answer())[2] == b"again" if kept else await client.rest() == b""


HALF = b"POST /v1/streams/s/play/x HTTP/1.1\r\nHost: h\r\nContent-Length: 9\r\n\r\nabc"
WHOLE = b"GET /healthz HTTP/1.1\r\nHost: h\r\n\r\n"


@pytest.mark.parametrize(
    ("sent", "least_s", "end", "kind"),
    [
        ((), 8, b"", "idle"),
        ((b"GET /",), 8, b"408", "head"),
        ((b"GET /", b"x", b"y"), 8, b"408", "head"),  # any time, but limited in total
        ((HALF,), 10, b"408", "head"),  # 2 s in which the rest may come
        ((WHOLE,), 15, b"200", "idle"),
        ((WHOLE, b"GET /"), 11, b"408", "head"),  # from its first byte on, 3 s later
    ],
)
@in_virtual_time
async def test_times_run_out(
    tmp_path: Path, sent: tuple[bytes, ...], least_s: float, end: bytes, kind: str
) -> None:
    state = ServerState(Library(tmp_path, 1.0), ServerConfig())
    with socket.socket() as sock:
        transport = MemoryTransport(sock)
        connection = ClientConnection(Application(state).clients, "192.0.2.1", lambda _: None)
        transport.set_protocol(connection)
        connection.connection_made(transport)
        for step in range(200):
            if step % 30 == 0 and step // 30 < len(sent):
                part = sent[step // 30]
                connection.get_buffer(-1)[: len(part)] = part
                connection.buffer_updated(len(part))
            await passes(0.1)
            connection.check(now_s())
            if transport.is_closing():
                break
        assert now_s() == pytest.approx(least_s, abs=0.2)
        statuses = re.findall(rb"HTTP/1.1 (\d+)", transport.sent)
        assert statuses[-1:] == ([end] if end else [])
        assert state.metrics.timeouts.value(kind) == 1
        connection.connection_lost(None)


async def test_a_client_that_goes_away_costs_its_own_response_only() -> None:
    ended: list[str] = []

    def endless(exchange: Exchange) -> StreamedResponse:
        async def produce(writer: BodyWriter) -> None:
            try:
                while True:
                    await writer.write(bytes(1000))
                    await passes(0)
            finally:
                ended.append(writer.cut)

        return StreamedResponse({}, produce)

    async with on_site({**ANSWERS, "/endless": endless}) as site:
        for path in ("/endless", "/large", "/late"):
            async with site.connect() as client, site.connect() as other:
                client.get(path)
                if path != "/late":
                    await client.reader.readexactly(200)
                client.writer.transport.abort()
                other.get("/ok")
                assert (await other.answer())[0] == 200
        async with site.connect() as client:  # closes cleanly
            client.get("/endless")
            await client.reader.readexactly(200)
            client.writer.write_eof()
            await client.rest()
        await eventually(lambda: len(site.done) == 7 and not site.acceptor.connections)
    assert ended == ["gone", "gone"]


async def test_a_body_that_fails_is_cut_off_so_that_it_shows() -> None:
    def failing(exchange: Exchange) -> StreamedResponse:
        async def produce(writer: BodyWriter) -> None:
            await writer.write(b"some")
            raise ValueError("no more")

        return StreamedResponse({}, produce)

    async with on_site({"/failing": failing}) as site, site.connect() as client:
        client.get("/failing")
        with pytest.raises((asyncio.IncompleteReadError, ConnectionError, ValueError)):
            await client.answer()
    assert [exchange.status for exchange in site.done] == [499]


async def test_a_flood_of_requests_is_bounded_and_others_have_their_turn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One client sends requests without end and reads nothing."""
    most = 0
    received = ClientConnection.buffer_updated

    def noting(self: ClientConnection, nbytes: int) -> None:
        nonlocal most
        received(self, nbytes)
        most = max(most, self._ahead_bytes + self.transport.get_write_buffer_size())

    monkeypatch.setattr(ClientConnection, "buffer_updated", noting)
    one = b"GET /short HTTP/1.1\r\nHost: h\r\n\r\n"
    async with (
        on_site({"/ok": text(), "/short": text(body=bytes(12_000))}) as site,
        site.connect(limit_bytes=1024) as greedy,
        site.connect() as other,
    ):
        greedy.send(one * 3000)
        for _ in range(50):
            other.get("/ok")
            assert (await other.answer())[0] == 200
        assert len(site.done) < 2000  # it was not read on
        for _ in range(3000):
            assert len((await greedy.answer())[2]) == 12_000
    assert most < 1 << 20


async def test_stopping_waits_for_what_was_asked() -> None:
    asked, done = asyncio.Event(), asyncio.Event()

    async def slow(exchange: Exchange) -> AnyResponse:
        asked.set()
        await done.wait()
        return Response(200, {}, b"done")

    async with on_site({"/slow": slow}) as site, site.connect() as idle, site.connect() as busy:
        busy.get("/slow")
        await asked.wait()
        site.state.stopping.set()
        for connection in list(site.acceptor.connections):
            connection.stop()
        assert await idle.rest() == b""
        done.set()
        status, _, body = await busy.answer()
        assert (status, body) == (200, b"done")
        assert await busy.rest() == b""


BODY = random.Random(7).randbytes(6_000_000)


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return make_certificate(tmp_path_factory.mktemp("tls"))


def speaking_tls(certificate: tuple[Path, Path]) -> tuple[ssl.SSLContext, ssl.SSLContext]:
    """TLS contexts of the server and of the client."""
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(*certificate)
    client = ssl.create_default_context(cafile=str(certificate[0]))
    client.check_hostname = False
    return server, client


Tls = tuple[ssl.SSLContext | None, ssl.SSLContext | None]


@pytest.fixture(scope="module", params=["plain", "tls"])
def tls(request: pytest.FixtureRequest) -> Tls:
    if request.param == "plain":
        return None, None
    return speaking_tls(request.getfixturevalue("certificate"))


def body(exchange: Exchange) -> Response:
    """A body of as many bytes as the query states."""
    assert exchange.request is not None
    return Response(200, {}, memoryview(BODY)[: int(exchange.request.query)])


async def test_bodies_of_any_size_come_whole_one_after_the_other(tls: Tls) -> None:
    sizes = 0, 1, 16_384, 16_385, 65_536, 1_000_000, 3, 1 << 20, (1 << 20) + 1, 5_999_999, 7

    async with on_site({"/body": body}, tls=tls[0]) as site, site.connect(tls[1]) as client:
        for size in sizes:
            client.get(f"/body?{size}")
            assert (await client.answer())[2] == BODY[:size]
        for size in sizes:
            client.get(f"/body?{size}")
        for size in sizes:
            assert (await client.answer())[2] == BODY[:size]
        client.get("/body?900000", "Connection: close")
        assert (await client.answer())[2] == BODY[:900_000]
        assert await client.rest() == b""
    assert not site.state.metrics.timeouts.value("write")
    sent_bytes = 2 * sum(sizes) + 900_000
    assert sent_bytes < site.state.sent_bytes < sent_bytes + 500 * len(site.done)


async def test_strangers_at_the_tls_port_leave_nothing_behind(
    certificate: tuple[Path, Path],
) -> None:
    server, client_tls = speaking_tls(certificate)
    hello = bytes.fromhex("1603010200010001fc0303") + bytes(517)
    async with on_site({"/ok": text()}, tls=server) as site:
        for sent in (b"GET / HTTP/1.1\r\nHost: h\r\n\r\n", bytes(500), hello, b"\x16\x03", b""):
            for _ in range(5):
                async with site.connect() as stranger:
                    stranger.send(sent)
                    stranger.writer.write_eof()
                    assert b"HTTP" not in await stranger.rest()
        await eventually(lambda: not site.admission.num_held)
        async with site.connect(client_tls) as client:
            client.get("/ok")
            assert (await client.answer())[0] == 200
