"""Requests to another worker of the server, such as a status report for a play that runs there: by
HTTP, over a Unix socket that each worker has in one folder.

Rule: no request waits for long for a worker that does not answer, and MAX_WAITING wait at most.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import aiohttp

TIMEOUT_S: Final = 1.0
"""Seconds that an answer may take."""

MAX_WAITING: Final = 256
"""Requests of one worker that wait for their answers; further ones have none."""


@dataclass(frozen=True, slots=True)
class WorkerAnswer:
    """The answer of another worker."""

    status: int
    headers: Mapping[str, str]
    body: bytes


class OtherWorkers:
    """How one worker reaches the others, and where it is reached itself. It must be used on one
    event loop, and be closed on it."""

    def __init__(
        self,
        folder: Path,
        number: int,
        count: Callable[[str], None],
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        """folder: of the sockets; only the workers may enter it. number: of this worker. count:
        called with the outcome of each request: "answered" or "unanswered"."""
        self._folder = folder
        self.number = number
        self._count = count
        self._timeout = aiohttp.ClientTimeout(total=timeout_s)
        self._sessions: dict[int, aiohttp.ClientSession] = {}
        self._num_waiting = 0

    def path(self, number: int) -> Path:
        """The socket of worker `number`."""
        return self._folder / f"{number}.sock"

    async def ask(self, number: int, path: str, body: bytes = b"") -> WorkerAnswer | None:
        """The answer of worker `number` to a POST; None if it does not answer or does not exist.

        path: as it is sent, with its %XX.
        """
        answer = None
        if self._num_waiting < MAX_WAITING:
            self._num_waiting += 1
            try:
                answer = await self._ask(number, path, body)
            except (aiohttp.ClientError, TimeoutError, OSError):  # it has died, or hangs
                pass
            finally:
                self._num_waiting -= 1
        self._count("unanswered" if answer is None else "answered")
        return answer

    async def _ask(self, number: int, path: str, body: bytes) -> WorkerAnswer:
        session = self._sessions.get(number)
        if session is None:
            session = self._sessions[number] = aiohttp.ClientSession(
                connector=aiohttp.UnixConnector(str(self.path(number)), limit=MAX_WAITING),
                timeout=self._timeout,
                cookie_jar=aiohttp.DummyCookieJar(),
            )
        async with session.post(f"http://worker{path}", data=body) as answer:
            return WorkerAnswer(answer.status, answer.headers, await answer.read())

    async def close(self) -> None:
        """Ends all connections; requests that wait end without an answer."""
        for session in self._sessions.values():
            await session.close()
