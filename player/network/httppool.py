"""Connections that are kept between requests, on a loop that runs only while somebody waits."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from .httpconnection import GrammarError, Head, Headers, HttpConnection, Target

MAX_IDLE = 4
"""Idle connections kept for a host: so many requests there are at a time."""


class HttpPool:
    """Requests may run side by side, each over a connection of its own."""

    def __init__(self, connect_timeout_s: float) -> None:
        self._connect_timeout_s = connect_timeout_s
        self.loop = asyncio.new_event_loop()
        self._idle: dict[tuple[str, str, int], list[HttpConnection]] = {}

    async def request(
        self,
        method: str,
        target: Target,
        fields: Mapping[str, str],
        body: bytes | None = None,
    ) -> Answer:
        """An answer whose body is yet to be read. Raises CannotConnectError, GrammarError, OSError
        and TimeoutError."""
        idle = self._idle.setdefault(target.place, [])
        if idle:
            await asyncio.sleep(0)  # a host may have closed some while the loop stood
        while idle:
            kept = idle.pop()
            if not kept.is_open():
                kept.close()
                continue
            try:
                return await self._ask(kept, method, target, fields, body)
            except (GrammarError, ConnectionError):
                # A host may close what is idle just as it is used again.
                if body is not None:
                    raise
        opened = await HttpConnection.open(target, self._connect_timeout_s)
        return await self._ask(opened, method, target, fields, body)

    async def _ask(
        self,
        connection: HttpConnection,
        method: str,
        target: Target,
        fields: Mapping[str, str],
        body: bytes | None,
    ) -> Answer:
        try:
            head = await connection.request(method, target, fields, body)
        except BaseException:
            connection.close()
            raise
        return Answer(self, target, connection, head)

    def keep(self, target: Target, connection: HttpConnection) -> None:
        """Takes back a connection whose answer was read to its end."""
        idle = self._idle.setdefault(target.place, [])
        if connection.is_reusable() and len(idle) < MAX_IDLE:
            idle.append(connection)
        else:
            connection.close()

    def close(self) -> None:
        """Closes what is idle, and the loop."""
        if self.loop.is_closed():
            return
        for idle in self._idle.values():
            for connection in idle:
                connection.close()
        self._idle.clear()
        # In one turn the loop lets go of what was closed.
        self.loop.run_until_complete(asyncio.sleep(0))
        self.loop.run_until_complete(self.loop.shutdown_asyncgens())
        self.loop.close()


class Answer:
    """An answer whose body is read piece by piece. Close it."""

    def __init__(
        self, pool: HttpPool, target: Target, connection: HttpConnection, head: Head
    ) -> None:
        self._pool, self._target = pool, target
        self._connection: HttpConnection | None = connection
        self.status: int = head.status
        self.headers: Headers = head.headers

    async def piece(self) -> bytes:
        """The next piece of the body, empty at its end. Raises GrammarError, OSError."""
        if self._connection is None:
            return b""
        piece = await self._connection.piece()
        if not piece:
            self._pool.keep(self._target, self._connection)
            self._connection = None
        return piece

    def close(self) -> None:
        """Drops what was not read, and the connection with it."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None
