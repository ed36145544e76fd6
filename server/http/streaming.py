"""Responses whose body is made while it is sent, such as plays."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Final, Protocol

from aiohttp import HttpVersion11, web

from .connection import connection_of
from .requestlog import COUNTED_BYTES, FACTS, Facts
from .tcpinfo import TcpInfo

TURN_BYTES: Final = 64 * 1024
"""Bytes of one response that are written before the other connections have their turn."""


class BodyWriter(Protocol):
    """Sends a body to one client, and knows the client's progress. All of it raises a
    ConnectionError when the client has gone."""

    @property
    def cut(self) -> str:
        """Why the connection is over: "gone" or "stalled"; empty while it is not."""

    def hold_at_most(self, queue_bytes: int) -> None:
        """Lets about `queue_bytes` wait unsent in the process, and as many in the kernel."""

    def queued_bytes(self) -> int:
        """Bytes written but not yet acknowledged by the client's side, as far as one can see."""

    def tcp_info(self) -> TcpInfo | None:
        """The kernel's figures of the connection; None if it reports none."""

    async def write(self, data: bytes) -> None:
        """Writes `data`, and waits until there is room for more."""


class StreamedBody:
    """The body of a response; see BodyWriter."""

    def __init__(
        self, request: web.Request, response: web.StreamResponse, count: Callable[[int], None]
    ) -> None:
        """count: called with the number of bytes sent, while they are sent: a play of an hour is
        load for the whole hour."""
        self._request = request
        self._response = response
        self._count = count
        self._counted_bytes = 0
        self._turn_bytes = 0  # written since the other connections had their turn
        connection = connection_of(request)
        self._connection = connection
        self.hold_at_most = connection.hold_at_most
        self.queued_bytes = connection.queued_bytes
        self.tcp_info = connection.tcp_info

    @property
    def cut(self) -> str:
        return self._connection.cut

    async def write(self, data: bytes) -> None:
        writer = self._request.writer
        try:
            await self._response.prepare(self._request)
            await self._response.write(data)
            await writer.drain()
        except ConnectionError:
            await asyncio.sleep(0)  # for the connection, which is told why it is lost
            raise
        self._count(writer.output_size - self._counted_bytes)
        self._request[COUNTED_BYTES] = self._counted_bytes = writer.output_size
        self._turn_bytes += len(data)
        if self._turn_bytes >= TURN_BYTES:
            self._turn_bytes = 0
            await asyncio.sleep(0)


async def stream(
    request: web.Request,
    headers: Mapping[str, str],
    produce: Callable[[BodyWriter], Awaitable[None]],
    count: Callable[[int], None],
    facts: Callable[[], Facts] = dict,
) -> web.StreamResponse:
    """Answers with what `produce` writes. The response ends when it returns, and is cut off when it
    raises. count: see StreamedBody. facts: gives what the log says of it at the end."""
    response = web.StreamResponse(headers=headers)
    if request.version < HttpVersion11:
        response.force_close()  # only the end of the connection ends it
    try:
        # Nothing may wait before: its end gives back what it holds.
        await produce(StreamedBody(request, response, count))
        await response.prepare(request)
        await response.write_eof()
        await connection_of(request).deliver(closing=not response.keep_alive)
    finally:
        request[FACTS] = facts()
    return response
