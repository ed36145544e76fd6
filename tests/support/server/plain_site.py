"""A site with fixed responses behind the server's HTTP, on a real socket, to test connections."""

from __future__ import annotations

import asyncio
import socket
import ssl
import tempfile
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any

from server.app import Application
from server.clients.acceptor import Acceptor
from server.exchange.exchange import Exchange
from server.exchange.request import Request
from server.exchange.response import AnyResponse, Response, error_response
from server.library import Library
from server.listener import bind
from server.operate.admission import Admission
from server.state.config import ServerConfig
from server.state.serverstate import ServerState
from tests.support.waiting import BOUND_S

Answer = AnyResponse | Coroutine[Any, Any, AnyResponse]
Answers = Mapping[str, Callable[[Exchange], Answer]]
"""The response of each path."""


class PlainSite(Application):
    """Sends the given responses, and keeps the finished exchanges."""

    def __init__(
        self,
        state: ServerState,
        answers: Answers,
        listener: socket.socket,
        tls: ssl.SSLContext | None,
    ) -> None:
        super().__init__(state)
        self._answers = answers
        self.done: list[Exchange] = []
        self.admission = Admission(1000, 1000)
        self.acceptor = Acceptor(self.clients, listener, self.admission, tls)
        self._port = listener.getsockname()[1]

    @asynccontextmanager
    async def connect(
        self, tls: ssl.SSLContext | None = None, limit_bytes: int = 1 << 16
    ) -> AsyncIterator[Client]:
        """Opens a connection. limit_bytes: approximate size of the client's read buffer."""
        reader, writer = await asyncio.open_connection(
            "127.0.0.1", self._port, ssl=tls, limit=limit_bytes
        )
        try:
            yield Client(reader, writer)
        finally:
            writer.transport.abort()
            with suppress(OSError):
                await writer.wait_closed()

    def answer(self, exchange: Exchange, request: Request) -> Answer:
        try:
            return self._answers[request.path](exchange)
        except KeyError:
            return error_response(404, "nothing", {})

    def finished(self, exchange: Exchange, now_s: float) -> None:
        super().finished(exchange, now_s)
        self.done.append(exchange)


def text(status: int = 200, body: bytes = b"ok\n") -> Callable[[Exchange], Response]:
    """A response that is always the same."""
    return lambda exchange: Response(status, {"Content-Type": "text/plain"}, body)


class Client:
    """One connection to a site."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer

    def send(self, data: bytes) -> None:
        self.writer.write(data)

    def get(self, path: str, *lines: str, version: str = "1.1") -> None:
        head = [f"GET {path} HTTP/{version}", "Host: h", *lines, "", ""]
        self.send("\r\n".join(head).encode())

    async def answer(self) -> tuple[int, dict[str, str], bytes]:
        """Status, fields by lower-case names, and body of the next response."""
        async with asyncio.timeout(BOUND_S):
            head = (await self.reader.readuntil(b"\r\n\r\n")).decode("latin-1")
            first, *lines = head[:-4].split("\r\n")
            status = int(first.split(" ")[1])
            fields = {
                name.lower(): value for name, value in (line.split(": ", 1) for line in lines)
            }
            if status in (100, 204, 304):
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

    async def rest(self) -> bytes:
        """All data until the server closes the connection."""
        async with asyncio.timeout(BOUND_S):
            return await self.reader.read()


@asynccontextmanager
async def on_site(answers: Answers, tls: ssl.SSLContext | None = None) -> AsyncIterator[PlainSite]:
    """Runs a site with these responses until the block ends. Fails the test if a callback or task
    of the event loop has failed by then."""
    failures: list[object] = []
    others = asyncio.all_tasks()
    asyncio.get_running_loop().set_exception_handler(lambda _, context: failures.append(context))
    config = ServerConfig()
    listener = bind("127.0.0.1", 0)
    with tempfile.TemporaryDirectory() as folder:
        site = PlainSite(
            ServerState(Library(folder, config.refresh_s), config), answers, listener, tls
        )
        site.acceptor.start()
        try:
            yield site
        finally:
            await site.acceptor.stop(2.0)
            listener.close()
            left = asyncio.all_tasks() - others
            for task in left:
                task.cancel()
            ended = await asyncio.gather(*left, return_exceptions=True)
    failures += [error for error in ended if isinstance(error, Exception)]
    assert site.admission.num_held == 0
    assert not failures, failures
