"""Connections over real sockets: the order of responses, and their end."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from server.clients.connection import ClientConnection
from server.clients.timeouts import TimeoutConfig
from server.exchange.exchange import Exchange
from server.exchange.response import AnyResponse, BodyWriter, Response, StreamedResponse
from tests.support.server.plain_site import Answers, on_site, text
from tests.support.waiting import wait_until

pytestmark = pytest.mark.anyio

QUICK = TimeoutConfig(request_timeout_s=0.4, keepalive_timeout_s=0.3, write_timeout_s=0.5)


def echo(exchange: Exchange) -> Response:
    assert exchange.request is not None
    return Response(200, {}, exchange.request.query.encode() + exchange.request.body)


async def late(exchange: Exchange) -> AnyResponse:
    await asyncio.sleep(0.01)
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
                    await asyncio.sleep(0)
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
            await asyncio.sleep(0.05)
            client.send(b"abc")  # an old client does not know what 100 is
            assert (await client.answer())[::2] == (200, b"abc")
        async with site.connect() as client:
            client.get("/echo", "Content-Length: 2000", "Expect: 100-continue", method="POST")
            assert (await client.answer())[0] == 413


@pytest.mark.realtime
async def test_times_run_out() -> None:
    async with on_site(ANSWERS, QUICK) as site:
        loop = asyncio.get_running_loop()
        async with site.connect() as client:  # sends nothing
            began_s = loop.time()
            assert await client.rest() == b""
            assert 0.3 < loop.time() - began_s < 2
        async with site.connect() as client:  # is done
            client.get("/ok")
            await client.answer()
            began_s = loop.time()
            assert await client.rest() == b""
            assert 0.2 < loop.time() - began_s < 2
        for begun in (b"GET /", b"POST /echo HTTP/1.1\r\nHost: h\r\nContent-Length: 9\r\n\r\nabc"):
            async with site.connect() as client:
                client.get("/ok")
                await client.answer()
                client.send(begun)
                began_s = loop.time()
                while loop.time() < began_s + 0.3:  # any time, but limited in total
                    await asyncio.sleep(0.05)
                    if begun.startswith(b"GET"):
                        client.send(b"x")
                status, fields, _ = await client.answer()
                assert (status, fields["connection"]) == (408, "close")
                assert loop.time() - began_s < 2
    assert site.cuts == ["head", "head", "idle", "idle"]


async def test_a_request_that_takes_its_time_is_not_cut() -> None:
    async def slow(exchange: Exchange) -> AnyResponse:
        await asyncio.sleep(1.2)
        return Response(200, {}, b"at last")

    async with on_site({"/slow": slow}, QUICK) as site, site.connect() as client:
        client.get("/slow")
        assert (await client.answer())[2] == b"at last"
    assert not site.cuts


async def test_a_client_that_goes_away_costs_its_own_response_only() -> None:
    ended: list[str] = []

    def endless(exchange: Exchange) -> StreamedResponse:
        async def produce(writer: BodyWriter) -> None:
            try:
                while True:
                    await writer.write(bytes(1000))
                    await asyncio.sleep(0.001)
            except asyncio.CancelledError:
                ended.append(writer.cut)
                raise

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
        await asyncio.to_thread(wait_until, lambda: not site.acceptor.connections)
    assert ended == ["gone", "gone"]
    assert len(site.done) == 7


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


@pytest.mark.realtime
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
        greedy.send(one * 20_000)
        loop, worst_s = asyncio.get_running_loop(), 0.0
        for _ in range(50):
            began_s = loop.time()
            other.get("/ok")
            await other.answer()
            worst_s = max(worst_s, loop.time() - began_s)
        assert len(site.done) < 10_000  # it was not read on
        assert worst_s < 0.5
        for _ in range(20_000):
            assert len((await greedy.answer())[2]) == 12_000
    assert most < 1 << 20


async def test_stopping_waits_for_what_was_asked() -> None:
    async def slow(exchange: Exchange) -> AnyResponse:
        await asyncio.sleep(0.3)
        return Response(200, {}, b"done")

    async with on_site({"/slow": slow}) as site, site.connect() as idle, site.connect() as busy:
        busy.get("/slow")
        await asyncio.sleep(0.05)
        site.state.stopping.set()
        for connection in list(site.acceptor.connections):
            connection.stop()
        assert await idle.rest() == b""
        status, _, body = await busy.answer()
        assert (status, body) == (200, b"done")
        assert await busy.rest() == b""


def test_times_that_make_no_sense_are_refused() -> None:
    for name in ("request_timeout_s", "keepalive_timeout_s", "write_timeout_s"):
        for wrong in (0.0, -1.0, float("inf"), float("nan"), 86401.0):
            with pytest.raises(Exception, match=name):
                replace(QUICK, **{name: wrong})
