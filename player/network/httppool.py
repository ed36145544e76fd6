"""Connections that are kept between requests, on a loop that runs only while somebody waits."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from .httpconnection import GrammarError, Head, Headers, HttpConnection, Target


class HttpPool:
    """One idle connection a host at most: requests come one after another."""

    def __init__(self, connect_timeout_s: float) -> None:
        self._connect_timeout_s = connect_timeout_s
        self.loop = asyncio.new_event_loop()
        self._idle: dict[tuple[str, str, int], HttpConnection] = {}

    async def request(
        self,
        method: str,
        target: Target,
        fields: Mapping[str, str],
        body: bytes | None = None,
    ) -> Answer:
        """An answer whose body is yet to be read. Raises CannotConnectError, GrammarError, OSError
        and TimeoutError."""
        kept = self._idle.pop(target.place, None)
        if kept is not None:
            await asyncio.sleep(0)  # the host may have closed it while the loop stood
            if kept.is_open():
                try:
                    return await self._ask(kept, method, target, fields, body)
                except (GrammarError, ConnectionError):
                    # A host may close what is idle just as it is used again.
                    if body is not None:
                        raise
            else:
                kept.close()
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
        if not connection.is_reusable():
            connection.close()
            return
        other = self._idle.pop(target.place, None)
        if other is not None:
            other.close()
        self._idle[target.place] = connection

    def close(self) -> None:
        """Closes what is idle, and the loop."""
        if self.loop.is_closed():
            return
        for connection in self._idle.values():
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
