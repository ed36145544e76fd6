"""Accepts connections from a listening socket, up to the limits.

Rule: without room or descriptors new clients wait in the kernel's queue, and the shortage is logged
once. Connected clients are not affected."""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import ssl
from contextlib import suppress
from typing import Final

from server.operate.admission import Admission

from .connection import ClientConnection, Clients, refusal

log = logging.getLogger(__name__)

CHECK_S: Final = 0.5
"""Most seconds between two looks at connections that take their time."""

PAUSE_S: Final = 0.25
"""Seconds without accepting when there was no descriptor or no room for one more."""

AT_ONCE: Final = 64
"""Connections accepted before the others have their turn."""

TLS_HANDSHAKE_S: Final = 8.0

_TOO_MANY: Final = refusal(429, "Too Many Requests", "Retry-After: 5")
"""For an address that has all the connections that one may have."""

_SHORT_OF: Final = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)


class Acceptor:
    """Takes the clients of one listening socket, until it is stopped."""

    def __init__(
        self,
        clients: Clients,
        listener: socket.socket,
        admission: Admission,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        """tls: None for plain HTTP."""
        self._clients = clients
        self._listener = listener
        self._admission = admission
        self._tls = tls
        self.connections = clients.connections
        """The open connections."""
        self._emptied = asyncio.Event()
        self._starting: set[asyncio.Task[None]] = set()
        self._stopping = False
        self._loop = asyncio.get_running_loop()
        self._check_handle: asyncio.TimerHandle | None = None
        self._pause_handle: asyncio.TimerHandle | None = None
        self._check_s = min(CHECK_S, clients.timeouts.least_s / 4)
        self._short = False  # whether descriptors were missing at the last accept

    def start(self) -> None:
        """Begins to accept."""
        self._listener.setblocking(False)
        self._loop.add_reader(self._listener, self._accept)
        self._check()

    def close(self) -> None:
        """Accepts no more; connections that wait in the kernel's queue are left to it."""
        self._loop.remove_reader(self._listener)
        if self._pause_handle is not None:
            self._pause_handle.cancel()
            self._pause_handle = None

    async def stop(self, timeout_s: float) -> None:
        """Ends: idle connections at once, the others when their response is over, or after
        `timeout_s` in any case."""
        self.close()
        self._stopping = True
        for connection in self._began():
            connection.stop()
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                await self._wait_until_empty()
        for task in self._starting:
            task.cancel()
        for connection in self._began():
            connection.abort()
        await self._wait_until_empty()
        if self._check_handle is not None:
            self._check_handle.cancel()

    def _began(self) -> list[ClientConnection]:
        """Without those that are still at their handshake."""
        return [connection for connection in self.connections if connection.began]

    async def _wait_until_empty(self) -> None:
        if self._starting:
            await asyncio.wait(self._starting)
        while self.connections:
            self._emptied.clear()
            await self._emptied.wait()

    def _accept(self) -> None:
        for _ in range(AT_ONCE):
            if not self._admission.has_room:
                self._pause()
                return
            try:
                sock, address = self._listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                if error.errno not in _SHORT_OF:
                    raise
                if not self._short:
                    log.error("no new connections are accepted for now: %s", error.strerror)
                self._short = True
                self._pause()
                return
            self._short = False
            self._begin(sock, str(address[0]))

    def _begin(self, sock: socket.socket, address: str) -> None:
        sock.setblocking(False)
        refused = self._admission.admit(address)
        if refused is not None:
            self._clients.metrics.refused.add(1, f"connection_{refused}")
            # Short enough for any send buffer; what the client has sent may cost it these words.
            if self._tls is None:
                with suppress(OSError):
                    sock.send(_TOO_MANY)
            sock.close()
            return
        task = self._loop.create_task(self._connect(sock, address))
        self._starting.add(task)
        task.add_done_callback(self._starting.discard)

    async def _connect(self, sock: socket.socket, address: str) -> None:
        connection = ClientConnection(self._clients, address, self._closed)
        self.connections.add(connection)
        seconds = TLS_HANDSHAKE_S if self._tls is not None else None
        try:
            with suppress(OSError):  # it went away, or does not speak TLS
                await self._loop.connect_accepted_socket(
                    lambda: connection, sock, ssl=self._tls, ssl_handshake_timeout=seconds
                )
        finally:
            if not connection.began:
                sock.close()
                self._closed(connection)
        if self._stopping and connection.began:
            connection.stop()

    def _closed(self, connection: ClientConnection) -> None:
        self._admission.release(connection.address)
        self.connections.discard(connection)
        if not self.connections:
            self._emptied.set()

    def _pause(self) -> None:
        self._loop.remove_reader(self._listener)
        self._clients.metrics.accept_pauses.add(1)
        self._pause_handle = self._loop.call_later(PAUSE_S, self._resume)

    def _resume(self) -> None:
        self._pause_handle = None
        self._loop.add_reader(self._listener, self._accept)

    def _check(self) -> None:
        now_s = self._loop.time()
        for connection in self._began():
            connection.check(now_s)
        self._check_handle = self._loop.call_later(self._check_s, self._check)
