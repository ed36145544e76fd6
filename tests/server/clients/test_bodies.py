"""Bodies over real sockets and TLS: complete, with little memory, and taking turns."""

from __future__ import annotations

import hashlib
import random
import ssl
from pathlib import Path

import pytest

from server.exchange.exchange import Exchange
from server.exchange.response import Response
from tests.support.server.certificates import make_certificate
from tests.support.server.plain_site import on_site, text
from tests.support.server.running_server import eventually
from tests.support.server.virtualtime import passes

pytestmark = pytest.mark.anyio

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
    assert not site.cuts
    sent_bytes = 2 * sum(sizes) + 900_000
    assert sent_bytes < site.state.sent_bytes < sent_bytes + 500 * len(site.done)


async def test_a_slow_reader_gets_every_byte_and_little_waits_in_the_process(tls: Tls) -> None:
    async with (
        on_site({"/body": body}, tls=tls[0]) as site,
        site.connect(tls[1], limit_bytes=2048) as client,
    ):
        client.get(f"/body?{len(BODY)}")
        await client.reader.readuntil(b"\r\n\r\n")
        hashed, left, most = hashlib.sha256(), len(BODY), 0
        (connection,) = site.acceptor.connections
        transport = connection.transport
        while left:
            piece = await client.reader.read(50_000)
            hashed.update(piece)
            left -= len(piece)
            waiting = transport.get_write_buffer_size()
            inner = getattr(transport, "_ssl_protocol", None)
            waiting += inner._transport.get_write_buffer_size() if inner is not None else 0
            most = max(most, waiting)
            await passes(0)
        assert hashed.digest() == hashlib.sha256(BODY).digest()
        # A piece of 512 KiB; TLS keeps it twice, as it came and coded.
        assert most <= (600_000 if tls[1] is None else 1_200_000)
    assert not site.cuts


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
