"""Responses whose body is made while it is sent, such as plays."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Final

from aiohttp import HttpVersion11, web

from .connection import connection_of
from .requestlog import COUNTED_BYTES

TURN_BYTES: Final = 64 * 1024
"""Bytes of one response that are written before the other connections have their turn."""


class StreamedResponse:
    """Sends a body to one client, and knows the client's progress. All of it raises a
    ConnectionError when the client has gone."""

    def __init__(
        self, request: web.Request, headers: Mapping[str, str], count: Callable[[int], None]
    ) -> None:
        """count: called with the number of bytes sent, while they are sent: a play of an hour is
        load for the whole hour."""
        self._request = request
        self._response = web.StreamResponse(headers=headers)
        if request.version < HttpVersion11:
            self._response.force_close()  # only the end of the connection ends it
        self._count = count
        self._counted_bytes = 0
        self._turn_bytes = 0  # written since the other connections had their turn
        self.connection = connection_of(request)

    async def write(self, data: bytes) -> None:
        """Writes `data`, and waits until there is room for more."""
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

    async def end(self) -> web.StreamResponse:
        """Ends the body, and waits until it has arrived; gives what the handler returns."""
        await self._response.prepare(self._request)
        await self._response.write_eof()
        await self.connection.deliver(closing=not self._response.keep_alive)
        return self._response
