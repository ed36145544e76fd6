"""Sends responses through aiohttp: whole ones from where they lie, streamed ones as they are made.

Rule: of what is to be sent, little waits in this process.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Final

from aiohttp import web

from server.exchange.response import StreamedResponse
from server.exchange.tcpinfo import TcpInfo

from .connection import ClientConnection

TURN_BYTES: Final = 1 << 20
"""Bytes of one response that are written before the other connections have their turn."""

STREAMED_TURN_BYTES: Final = 64 * 1024
"""The same of a streamed one, whose bytes also have to be made."""


class Written(web.StreamResponse):
    """The result of a handler that has written its response itself."""

    def __init__(self, keep_alive: bool) -> None:
        super().__init__()
        self._stays = keep_alive

    @property
    def keep_alive(self) -> bool:
        return self._stays

    async def prepare(self, request: web.BaseRequest) -> None:
        """Has nothing to do."""

    async def write_eof(self, data: bytes = b"") -> None:
        """Has nothing to do."""


KEPT: Final = Written(keep_alive=True)
CLOSED: Final = Written(keep_alive=False)


async def send(
    request: web.BaseRequest, connection: ClientConnection, head: bytes, body: bytes | memoryview
) -> None:
    """Writes a response whose head was prepared, the body piece by piece as the client takes it.

    Not through web.Response, which makes each head anew: a quarter of what a request costs. Raises
    ConnectionError if the client has gone.
    """
    writer, start = request.writer, connection.piece_bytes
    view = memoryview(body) if len(body) > start else b""
    await writer.write(b"".join((head, body if not view else view[:start])))
    await writer.drain()
    turn_bytes = 0  # written since the other connections had their turn
    while start < len(view):
        if turn_bytes >= TURN_BYTES:
            turn_bytes = 0
            await asyncio.sleep(0)
        piece = view[start : start + connection.piece_bytes]
        await writer.write(piece)
        await writer.drain()
        start, turn_bytes = start + len(piece), turn_bytes + len(piece)


class StreamedBody:
    """The body of a streamed response; see BodyWriter."""

    def __init__(
        self,
        request: web.BaseRequest,
        streamed: StreamedResponse,
        connection: ClientConnection,
        common: Mapping[str, str],
        count: Callable[[int], None],
    ) -> None:
        """common: fields that every response has. count: called with the number of bytes sent,
        while they are sent: a play of an hour is load for the whole hour."""
        self.response = web.StreamResponse(headers={**common, **streamed.fields})
        self._request = request
        self._connection = connection
        self._count = count
        self._turn_bytes = 0  # written since the other connections had their turn
        self.num_bytes = 0
        """Written so far."""

    @property
    def cut(self) -> str:
        return self._connection.cut

    def hold_at_most(self, queue_bytes: int) -> None:
        self._connection.hold_at_most(queue_bytes)

    def queued_bytes(self) -> int:
        return self._connection.queued_bytes()

    def tcp_info(self) -> TcpInfo | None:
        return self._connection.tcp_info()

    async def write(self, data: bytes) -> None:
        if not self.response.prepared:
            await self.response.prepare(self._request)
        await self.response.write(data)
        await self._request.writer.drain()
        self._count(self._connection.take_sent_bytes())
        self.num_bytes += len(data)
        self._turn_bytes += len(data)
        if self._turn_bytes >= STREAMED_TURN_BYTES:
            self._turn_bytes = 0
            await asyncio.sleep(0)

    async def end(self) -> None:
        """Writes what says that the body is whole."""
        await self.response.prepare(self._request)
        await self.response.write_eof()
