"""Connections over real sockets and TLS: whole bodies, their ends, and the ends of connections."""

from __future__ import annotations

import asyncio
import random
import re
import ssl
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import pytest
from aiohttp import web

from server.http.content import Content, StreamedResponse, serve
from server.operate.workers import SupervisorConfig
from tests.support.server.certificates import make_certificate
from tests.support.server.plain_site import Answers, Handler, connected, in_memory, on_site, text
from tests.support.server.running_server import eventually, quick_config
from tests.support.server.virtualtime import in_virtual_time, now_s, passes
from tests.support.waiting import BOUND_S

pytestmark = pytest.mark.anyio

BODY = random.Random(7).randbytes(6_000_000)


def streamed(produce: Callable[[StreamedResponse], Awaitable[None]]) -> Handler:
    async def answer(request: web.Request) -> web.StreamResponse:
        response = StreamedResponse(request, {}, lambda num_bytes: None)
        await produce(response)
        return await response.end()

    return answer


async def chunks(response: StreamedResponse) -> None:
    for word in (b"some ", b"", b"words"):
        await response.write(word)


async def body(request: web.Request) -> web.StreamResponse:
    """A body of as many bytes as the query states."""
    data = BODY[: int(request.query_string)]
    return await serve(request, Content(data, "f00d", "text/plain", "no-cache"))


ANSWERS: Answers = {
    "/ok": text(),
    "/chunks": streamed(chunks),
    "/body": body,
    "/304": text(304, b""),
}


@pytest.mark.parametrize(
    ("path", "version", "line", "kept"),
    [
        ("/ok", "1.1", "X: y", True),
        ("/304", "1.1", "X: y", True),
        ("/chunks", "1.1", "X: y", True),
        ("/body?900000", "1.1", "X: y", True),
        ("/ok", "1.1", "Connection: close", False),
        ("/body?900000", "1.1", "Connection: close", False),
        ("/ok", "1.0", "X: y", False),
        ("/ok", "1.0", "Connection: keep-alive", True),
        ("/chunks", "1.0", "Connection: keep-alive", False),  # its end is the end of the body
    ],
)
async def test_a_connection_is_kept_where_both_want_it(
    path: str, version: str, line: str, kept: bool
) -> None:
    async with on_site(ANSWERS) as site, connected(site) as client:
        client.get(path, line, version=version)
        _, fields, body = await client.answer()
        assert kept or version == "1.0" or fields["connection"] == "close"
        assert path != "/chunks" or body == b"some words"
        client.get("/body?3")
        assert (await client.answer())[2] == BODY[:3] if kept else await client.rest() == b""


HALF = b"POST /v1/streams/s/play/x HTTP/1.1\r\nHost: h\r\nContent-Length: 9\r\n\r\nabc"
WHOLE = b"GET /healthz HTTP/1.1\r\nHost: h\r\n\r\n"


@pytest.mark.parametrize(
    ("sent", "least_s", "end"),
    [
        ((), 15, b""),
        ((b"GET /",), 15, b""),
        ((b"GET /", b"x", b"y"), 15, b""),  # any time, but limited in total
        ((HALF,), 17, b"408"),  # 2 s in which the rest may come
        ((WHOLE,), 15, b"200"),
        ((b"GET /", WHOLE[5:], b"GET /"), 18, b"200"),  # from the response on, 3 s later
    ],
)
@in_virtual_time
async def test_times_run_out(
    tmp_path: Path, sent: tuple[bytes, ...], least_s: float, end: bytes
) -> None:
    async with in_memory(tmp_path) as (connection, transport, state, _):
        for step in range(300):
            if step % 30 == 0 and step // 30 < len(sent):
                connection.data_received(sent[step // 30])
            await passes(0.1)
            if transport.is_closing():
                break
        assert now_s() == pytest.approx(least_s, abs=0.2)
        statuses = re.findall(rb"HTTP/1.1 (\d+)", transport.sent)
        assert statuses == ([end] if end else [])
        assert state.metrics.timeouts.value("body") == (sent == (HALF,))


async def test_a_client_that_goes_away_costs_its_own_response_only() -> None:
    ended: list[str] = []

    async def endless(response: StreamedResponse) -> None:
        try:
            while True:
                await response.write(bytes(1000))
                await passes(0)
        finally:
            ended.append(response.connection.cut)

    async with on_site({**ANSWERS, "/endless": streamed(endless)}) as site:
        for path in ("/endless", "/body?6000000"):
            async with connected(site) as client, connected(site) as other:
                client.get(path)
                await client.reader.readexactly(200)
                client.writer.transport.abort()
                other.get("/ok")
                assert (await other.answer())[0] == 200
        async with connected(site) as client:  # closes cleanly
            client.get("/endless")
            await client.reader.readexactly(200)
            client.writer.write_eof()
            await client.rest()
        await eventually(lambda: len(site.log.kept) == 5 and not site.state.connections.num_held)
    assert ended == ["gone", "gone"]
    assert sorted(str(line["status"]) for line in site.log.kept) == ["200", "200", *3 * ["499"]]


async def test_a_body_that_fails_is_cut_off_so_that_it_shows(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def failing(response: StreamedResponse) -> None:
        await response.write(b"some")
        raise ValueError("no more")

    async with on_site({"/failing": streamed(failing)}) as site, connected(site) as client:
        client.get("/failing")
        with pytest.raises((asyncio.IncompleteReadError, ConnectionError, ValueError)):
            await client.answer()
    assert [line["status"] for line in site.log.kept] == [499]
    assert [record.getMessage() for record in caplog.records] == ["/failing failed"]


async def test_what_a_handler_raises_keeps_its_text_and_headers() -> None:
    async def locked(request: web.Request) -> web.Response:
        raise web.HTTPForbidden(text="not today", headers={"X-Why": "Sunday"})

    async with on_site({"/locked": locked}) as site, connected(site) as client:
        client.get("/locked")
        status, fields, said = await client.answer()
    assert (status, fields["x-why"], said) == (403, "Sunday", b'{"error": "not today"}')


async def test_a_flood_of_requests_is_bounded_and_others_have_their_turn() -> None:
    """One client sends requests without end and reads nothing."""
    one = b"GET /short HTTP/1.1\r\nHost: h\r\n\r\n"
    async with (
        on_site({"/ok": text(), "/short": text(body=bytes(12_000))}) as site,
        connected(site, limit_bytes=1024) as greedy,
        connected(site) as other,
    ):
        greedy.send(one * 3000)
        for _ in range(50):
            other.get("/ok")
            assert (await other.answer())[0] == 200
        assert len(site.log.kept) < 2000  # it was not read on
        assert max(one.queued_bytes() for one in site.server.connections) < 16 << 20
        for _ in range(3000):
            assert len((await greedy.answer())[2]) == 12_000


async def test_stopping_waits_for_what_was_asked_and_for_who_has_just_come() -> None:
    asked, done = asyncio.Event(), asyncio.Event()

    async def slow(request: web.Request) -> web.Response:
        asked.set()
        await done.wait()
        return web.Response(body=b"done")

    # The block of the server ends while these have no answer. Nothing waits for its time to be up.
    answers = {"/slow": slow, "/ok": text()}
    config = replace(quick_config(), supervisor=SupervisorConfig(shutdown_timeout_s=99 * BOUND_S))
    async with on_site(answers, config) as site, connected(site) as idle, connected(site) as busy:
        idle.get("/ok")
        await idle.answer()
        busy.get("/slow")
        await asked.wait()
        async with connected(site) as new:
            await eventually(lambda: site.state.connections.num_held == 3)
            stopping = asyncio.create_task(site.server.stop())
            await site.state.stopping.wait()
            new.get("/ok")
            assert (await new.answer())[0] == 200
        assert await idle.rest() == b""
        done.set()
        status, _, body = await busy.answer()
        assert (status, body) == (200, b"done")
        assert await busy.rest() == b""
        await stopping


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return make_certificate(tmp_path_factory.mktemp("tls"))


def trusting(certificate: Path) -> ssl.SSLContext:
    client = ssl.create_default_context(cafile=str(certificate))
    client.check_hostname = False
    return client


@pytest.mark.parametrize("kind", ["plain", "tls"])
async def test_bodies_of_any_size_come_whole_one_after_the_other(
    kind: str, certificate: tuple[Path, Path]
) -> None:
    sizes = 0, 1, 16_384, 16_385, 65_536, 65_537, 1_000_000, 3, 1 << 20, (1 << 20) + 1, 5_999_999, 7
    config, tls = quick_config(), None
    if kind == "tls":
        config = replace(config, tls_cert=certificate[0], tls_key=certificate[1])
        tls = trusting(certificate[0])
    async with on_site(ANSWERS, config) as site, connected(site, tls) as client:
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
    assert sent_bytes < site.state.sent_bytes < sent_bytes + 700 * len(site.log.kept)
    assert sum(int(str(line["bytes"])) for line in site.log.kept) == site.state.sent_bytes


async def test_strangers_at_the_tls_port_leave_nothing_behind(
    certificate: tuple[Path, Path],
) -> None:
    hello = bytes.fromhex("1603010200010001fc0303") + bytes(517)
    config = replace(quick_config(), tls_cert=certificate[0], tls_key=certificate[1])
    async with on_site({"/ok": text()}, config) as site:
        for sent in (b"GET / HTTP/1.1\r\nHost: h\r\n\r\n", bytes(500), hello, b"\x16\x03", b""):
            for _ in range(5):
                async with connected(site) as stranger:
                    stranger.send(sent)
                    stranger.writer.write_eof()
                    assert b"HTTP" not in await stranger.rest()
        await eventually(lambda: not site.state.connections.num_held)
        async with connected(site, trusting(certificate[0])) as client:
            client.get("/ok")
            assert (await client.answer())[0] == 200
