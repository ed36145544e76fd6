"""A server with fixed answers besides its own, raw clients of it, and a connection in memory."""

from __future__ import annotations

import asyncio
import socket
import ssl
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from unittest import mock

from aiohttp import web

from server import app
from server.http.connection import Connection
from server.library import Library
from server.operate.log import LogRequests
from server.serving import RunningServer
from server.state.config import ServerConfig
from server.state.serverstate import ServerState
from tests.support.server.running_server import Lines, Running, quick_config, running
from tests.support.waiting import BOUND_S

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
Answers = Mapping[str, Handler]
"""The handler of each path."""


def text(status: int = 200, body: bytes = b"ok\n") -> Handler:
    """A response that is always the same."""

    async def answer(request: web.Request) -> web.Response:
        return web.Response(status=status, body=body, content_type="text/plain")

    return answer


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
async def connected(
    server: Running, tls: ssl.SSLContext | None = None, limit_bytes: int = 1 << 16
) -> AsyncIterator[Client]:
    """A client. limit_bytes: approximate size of its read buffer."""
    reader, writer = await asyncio.open_connection(
        "127.0.0.1", server.port, ssl=tls, limit=limit_bytes
    )
    try:
        yield Client(reader, writer)
    finally:
        writer.transport.abort()
        with suppress(OSError):
            await writer.wait_closed()


@asynccontextmanager
async def on_site(answers: Answers, config: ServerConfig | None = None) -> AsyncIterator[Running]:
    """Runs a server with these answers until the block ends. Fails the test if a callback or task
    of the event loop has failed by then."""
    failures: list[object] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: failures.append(context))
    routes = [*app.ROUTES, *(web.get(path, handler) for path, handler in answers.items())]
    with tempfile.TemporaryDirectory() as folder, mock.patch("server.app.ROUTES", routes):
        async with running(Path(folder), config or quick_config()) as server:
            yield server
    assert server.state.connections.num_held == 0
    assert not failures, failures


class MemoryTransport(asyncio.Transport):
    """Keeps what was written until the test takes it."""

    def __init__(self, sock: socket.socket) -> None:
        """sock: one of which the kernel says nothing."""
        super().__init__({"peername": ("192.0.2.1", 1), "socket": sock})
        self.sent = bytearray()
        self.protocol: asyncio.Protocol | None = None
        self._high = 65_536
        self._is_closing = self._is_paused = False

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._high = high or self._high

    def get_write_buffer_size(self) -> int:
        return len(self.sent)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.sent += data
        if self.protocol is not None and not self._is_paused and len(self.sent) > self._high:
            self._is_paused = True
            self.protocol.pause_writing()

    def take(self, num_bytes: int) -> None:
        """What the client takes."""
        del self.sent[:num_bytes]
        if self.protocol is not None and self._is_paused and len(self.sent) <= self._high // 4:
            self._is_paused = False
            self.protocol.resume_writing()

    def is_closing(self) -> bool:
        return self._is_closing

    def close(self) -> None:
        self._is_closing = True

    abort = close

    def can_write_eof(self) -> bool:
        return False

    def pause_reading(self) -> None:
        pass

    resume_reading = pause_reading


@asynccontextmanager
async def in_memory(
    root: Path,
) -> AsyncIterator[tuple[Connection, MemoryTransport, ServerState, Lines]]:
    """A connection to a server for `root` without any socket, for virtual time."""
    config, log = ServerConfig(log_requests=LogRequests.ALL), Lines()
    state = ServerState(Library(root, config.refresh_s), config)
    runner = RunningServer(state, log)
    await runner.setup()
    connection = runner.server()
    with socket.socket(socket.AF_UNIX) as sock:
        transport = MemoryTransport(sock)
        transport.protocol = connection
        connection.connection_made(transport)
        try:
            yield connection, transport, state, log
        finally:
            connection.connection_lost(None)
            await runner.cleanup()
