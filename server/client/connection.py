"""The sending side of one client's connection: short queues, bounded waits, and a view of both.

Rule: whatever a client does or does not do, sending to it ends within the write timeout.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Final

from aiohttp import web

from .tcpinfo import TcpInfo, read_tcp_info, unacked_bytes

PIECE_BYTES: Final = 256 * 1024
"""Bytes written in one go: each piece has the write timeout for itself, and only one is copied into
the send buffer of a slow client."""


class StalledError(Exception):
    """The client did not take anything for the whole write timeout; its connection was cut."""


def bound_connections(listener: socket.socket, write_timeout_s: float) -> None:
    """Bounds what a peer that takes nothing costs: PIECE_BYTES in the kernel, and for a while only.

    The kernel cuts such a connection after twice the timeout. That covers what the handlers cannot
    see, bytes that are still in buffers after a response; twice, so that a handler that waits knows
    and counts first. Accepted connections inherit both from `listener`.
    """
    if hasattr(socket, "TCP_NOTSENT_LOWAT"):
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, PIECE_BYTES)
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        milliseconds = max(1, round(2000 * write_timeout_s))
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, milliseconds)


class Connection:
    """What `request`'s client is sent goes through here."""

    def __init__(self, request: web.Request, write_timeout_s: float) -> None:
        self._request = request
        self._write_timeout_s = write_timeout_s

    @property
    def gone(self) -> bool:
        """Whether the client has closed the connection."""
        transport = self._request.transport
        return transport is None or transport.is_closing()

    def keep_queue_short(self, queue_bytes: int) -> None:
        """Lets about `queue_bytes` wait unsent in the process, and as many in the kernel."""
        transport = self._request.transport
        if transport is None:
            return
        transport.set_write_buffer_limits(high=queue_bytes)
        sock = transport.get_extra_info("socket")
        if sock is not None and hasattr(socket, "TCP_NOTSENT_LOWAT"):
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, queue_bytes)

    def queued_bytes(self) -> int:
        """Bytes written but not yet acknowledged by the client's side, as far as one can see."""
        transport = self._request.transport
        if transport is None:
            return 0
        sock = transport.get_extra_info("socket")
        return transport.get_write_buffer_size() + (unacked_bytes(sock) if sock is not None else 0)

    def tcp_info(self) -> TcpInfo | None:
        """What the kernel knows of it; None where it does not tell, or not any more."""
        transport = self._request.transport
        sock = transport.get_extra_info("socket") if transport is not None else None
        return read_tcp_info(sock) if sock is not None else None

    async def send(self, response: web.StreamResponse, data: bytes | memoryview) -> None:
        """Writes `data` and waits until the send buffer has room again."""
        view = memoryview(data)
        for start in range(0, len(view), PIECE_BYTES):
            async with self._deadline():
                await response.write(view[start : start + PIECE_BYTES])
                await self._request.writer.drain()
                # A client that takes all at once must not keep the loop from the others.
                await asyncio.sleep(0)

    async def prepare(self, response: web.StreamResponse) -> None:
        """Sends the head of `response`."""
        async with self._deadline():
            await response.prepare(self._request)

    async def finish(self, response: web.StreamResponse) -> None:
        """Sends whatever of `response` has not been sent, and its end."""
        async with self._deadline():
            await response.prepare(self._request)
            await response.write_eof()

    @asynccontextmanager
    async def _deadline(self) -> AsyncIterator[None]:
        try:
            async with asyncio.timeout(self._write_timeout_s):
                yield
        except TimeoutError as error:
            if self._request.transport is not None:
                self._request.transport.abort()
            raise StalledError from error
