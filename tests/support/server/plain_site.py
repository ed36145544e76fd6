"""A site of a few answers behind the server's HTTP, on a real socket, for tests of connections."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any

from server.http.acceptor import Acceptor
from server.http.errors import RequestError
from server.http.response import AnyResponse, HeadWriter, Response, error_response
from server.http.site import Connection, Exchange, PatienceConfig, Site
from server.listener import bind

Answer = AnyResponse | Coroutine[Any, Any, AnyResponse]
Answers = Mapping[str, Callable[[Exchange], Answer]]
"""What each path gives."""


class PlainSite(Site):
    """Gives its answers, and remembers what became of them."""

    def __init__(self, answers: Answers, patience: PatienceConfig, max_connections: int) -> None:
        self.answers = answers
        self.patience = patience
        self.connections: set[Connection] = set()
        self.emptied = asyncio.Event()
        self.heads = HeadWriter({})
        self.max_body_bytes = 1024
        self.max_connections = max_connections
        self.is_stopping = False
        self.held = 0
        """Connections admitted and not given back."""
        self.done: list[Exchange] = []
        self.errors: list[Exception] = []
        self.cuts: list[str] = []
        self.num_pauses = 0
        self.num_bytes = 0

    @property
    def stopping(self) -> bool:
        return self.is_stopping

    def answer(self, exchange: Exchange) -> Answer:
        assert exchange.request is not None
        try:
            return self.answers[exchange.request.path](exchange)
        except KeyError:
            return error_response(404, "nothing", {})
        except RequestError as error:
            return error_response(error.status, str(error), error.headers)

    def failed(self, exchange: Exchange, error: Exception) -> None:
        self.errors.append(error)

    def finished(self, exchange: Exchange, now_s: float) -> None:
        self.done.append(exchange)

    def sent(self, num_bytes: int) -> None:
        self.num_bytes += num_bytes

    def cut(self, kind: str) -> None:
        self.cuts.append(kind)

    def has_room(self) -> bool:
        return self.held < self.max_connections

    def paused(self) -> None:
        self.num_pauses += 1

    def admit(self, address: str) -> bytes | None:
        self.held += 1
        return None

    def closed(self, address: str) -> None:
        self.held -= 1


def text(status: int = 200, body: bytes = b"ok\n") -> Callable[[Exchange], Response]:
    """An answer that is always the same."""
    return lambda exchange: Response(status, {"Content-Type": "text/plain"}, body)


class Client:
    """One connection to a site."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer

    def send(self, data: bytes) -> None:
        self.writer.write(data)

    def get(self, path: str, *lines: str, method: str = "GET", version: str = "1.1") -> None:
        head = [f"{method} {path} HTTP/{version}", "Host: h", *lines, "", ""]
        self.send("\r\n".join(head).encode())

    async def answer(
        self, head_only: bool = False, timeout_s: float = 20.0
    ) -> tuple[int, dict[str, str], bytes]:
        """Status, fields by small names and body of the next response."""
        async with asyncio.timeout(timeout_s):
            head = (await self.reader.readuntil(b"\r\n\r\n")).decode("latin-1")
            first, *lines = head[:-4].split("\r\n")
            status = int(first.split(" ")[1])
            fields = {
                name.lower(): value for name, value in (line.split(": ", 1) for line in lines)
            }
            if head_only or status in (100, 204, 304):
                return status, fields, b""
            if fields.get("transfer-encoding") != "chunked":
                if "content-length" not in fields:
                    return status, fields, await self.reader.read()
                return status, fields, await self.reader.readexactly(int(fields["content-length"]))
            body = b""
            while size := int(await self.reader.readline(), 16):
                body += await self.reader.readexactly(size)
                assert await self.reader.readexactly(2) == b"\r\n"
            assert await self.reader.readexactly(2) == b"\r\n"
            return status, fields, body

    async def rest(self, timeout_s: float = 20.0) -> bytes:
        """What comes until the server ends the connection."""
        async with asyncio.timeout(timeout_s):
            return await self.reader.read()


class RunningSite:
    """A site that is served."""

    def __init__(self, site: PlainSite, port: int) -> None:
        self.site = site
        self.port = port

    @asynccontextmanager
    async def connect(
        self, tls: ssl.SSLContext | None = None, limit_bytes: int = 1 << 16
    ) -> AsyncIterator[Client]:
        """limit_bytes: about what the client takes before it is asked for more."""
        reader, writer = await asyncio.open_connection(
            "127.0.0.1", self.port, ssl=tls, limit=limit_bytes
        )
        try:
            yield Client(reader, writer)
        finally:
            writer.transport.abort()
            with suppress(OSError):
                await writer.wait_closed()


def on_site(
    answers: Answers,
    check: Callable[[RunningSite], Awaitable[None]],
    patience: PatienceConfig | None = None,
    tls: ssl.SSLContext | None = None,
    max_connections: int = 1000,
) -> PlainSite:
    """Runs `check` against a site with these answers; gives the site when all has ended."""
    failures: list[object] = []

    async def run() -> PlainSite:
        asyncio.get_running_loop().set_exception_handler(
            lambda loop, context: failures.append(context)
        )
        listener = bind("127.0.0.1", 0)
        site = PlainSite(answers, patience or PatienceConfig(), max_connections)
        acceptor = Acceptor(site, listener, tls)
        acceptor.start()
        try:
            await check(RunningSite(site, listener.getsockname()[1]))
        finally:
            await acceptor.stop(2.0)
            listener.close()
        assert site.held == 0
        return site

    site = asyncio.run(run())
    assert not failures, failures
    return site
