"""Connections over real sockets: the order of responses, and their end."""

from __future__ import annotations

import asyncio
import re
import socket
from dataclasses import replace
from pathlib import Path

import pytest

from fuzz.http import MemoryTransport
from server.app import Application
from server.clients.connection import ClientConnection
from server.clients.timeouts import TimeoutConfig
from server.exchange.exchange import Exchange
from server.exchange.response import AnyResponse, BodyWriter, Response, StreamedResponse
from server.library import Library
from server.state.config import ServerConfig
from server.state.serverstate import ServerState
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
    "/404": text(404),
}


async def test_a_hundred_requests_at_once_are_answered_in_order() -> None:
    async with on_site(ANSWERS) as site, site.connect() as client:
        paths = ["/echo", "/late", "/echo", "/chunks"]
        for n in range(100):
            client.get(f"{paths[n % 4]}?{n}")
        for n in range(100):
            expected = b"some words" if n % 4 == 3 else str(n).encode()
            assert (await client.answer())[::2] == (200, expected)
    assert len(site.done) == 100


async def test_requests_in_pieces_of_any_size_are_the_same() -> None:
    sent = b"".join(
        b"POST /echo?%d HTTP/1.1\r\nHost: h\r\nContent-Length: %d\r\n\r\n%s" % (n, n, b"x" * n)
        for n in range(9)
    )
    async with on_site(ANSWERS) as site:
        for size in (1, 2, 3, 7, 40):
            async with site.connect() as client:
                for start in range(0, len(sent), size):
                    client.send(sent[start : start + size])
                    await passes(0)
                for n in range(9):
                    assert (await client.answer())[2] == str(n).encode() + b"x" * n


@pytest.mark.parametrize("how", ["/304", "/404", "/ok", "/late", "/chunks", "HEAD", "POST"])
async def test_a_connection_is_used_again_after(how: str) -> None:
    async with on_site(ANSWERS) as site, site.connect() as client:
        for _ in range(2):
            if how == "HEAD":
                client.get("/large", method="HEAD")
                status, fields, _ = await client.answer(head_only=True)
                assert (status, fields["content-length"]) == (200, str(1 << 20))
            elif how == "POST":
                client.get("/echo", "Content-Length: 3", method="POST")
                client.send(b"abc")
                assert (await client.answer())[2] == b"abc"
            else:
                client.get(how)
                status, fields, _ = await client.answer()
                assert "connection" not in fields
            client.get("/echo?again")
            assert (await client.answer())[2] == b"again"


async def test_who_sends_no_more_still_gets_all_that_it_asked_for() -> None:
    async with on_site(ANSWERS) as site:
        for paths in (["/ok"], ["/large"], ["/late"], ["/ok", "/late", "/large", "/ok", "/late"]):
            async with site.connect() as client:
                for path in paths:
                    client.get(path)
                client.writer.write_eof()
                sizes = [len((await client.answer())[2]) for _ in paths]
                assert sizes == [{"/ok": 3, "/large": 1 << 20, "/late": 0}[path] for path in paths]
                assert await client.rest() == b""
        async with site.connect() as client:
            client.get("/ok")
            client.send(b"GET /o")
            client.writer.write_eof()
            assert (await client.answer())[0] == 200
            assert await client.rest() == b""


async def test_old_clients_are_asked_back_only_if_they_want() -> None:
    async with on_site(ANSWERS) as site:
        async with site.connect() as client:
            client.get("/ok", "Connection: keep-alive", version="1.0")
            assert (await client.answer())[1]["connection"] == "keep-alive"
            client.get("/chunks", version="1.0")
            _, fields, body = await client.answer()
            assert (body, fields.get("connection")) == (b"some words", None)
            assert "transfer-encoding" not in fields
        async with site.connect() as client:
            client.get("/ok", version="1.0")
            assert (await client.answer())[1]["connection"] == "close"
            assert await client.rest() == b""
        async with site.connect() as client:
            client.get("/ok", "Connection: close")
            assert (await client.answer())[1]["connection"] == "close"
            client.get("/ok")
            assert await client.rest() == b""
    assert len(site.done) == 4


async def test_who_asks_is_told_to_go_on() -> None:
    lines = "Content-Length: 3", "Expect: 100-continue"
    async with on_site(ANSWERS) as site:
        async with site.connect() as client:
            client.get("/echo", *lines, method="POST")
            assert (await client.answer())[0] == 100
            client.send(b"abc")
            assert (await client.answer())[::2] == (200, b"abc")
            client.get("/echo?no-body", "Expect: 100-continue")
            assert (await client.answer())[::2] == (200, b"no-body")
        async with site.connect() as client:
            client.get("/echo", *lines, method="POST", version="1.0")
            client.send(b"abc")  # an old client does not know what 100 is
            assert (await client.answer())[::2] == (200, b"abc")
        async with site.connect() as client:
            client.get("/echo", "Content-Length: 2000", "Expect: 100-continue", method="POST")
            assert (await client.answer())[0] == 413


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


def test_times_that_make_no_sense_are_refused() -> None:
    for name in ("request_timeout_s", "keepalive_timeout_s", "write_timeout_s"):
        for wrong in (0.0, -1.0, float("inf"), float("nan"), 86401.0):
            with pytest.raises(Exception, match=name):
                replace(TimeoutConfig(), **{name: wrong})
