"""What the workers of one server have of each other: requests over Unix sockets, such as a status
report for a play that runs there; tokens of plays that say which worker runs them; and a folder.

Rule: no request waits for long for a worker that does not answer, and MAX_WAITING wait at most.
"""

from __future__ import annotations

import hmac
import math
import os
import re
import secrets
import shutil
import sys
import tempfile
from base64 import urlsafe_b64encode
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import aiohttp

from codec.errors import InvalidError

if sys.platform != "win32":
    import fcntl

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


_TOKEN = re.compile(r"(0|[1-9][0-9]{0,2})-([0-9a-f]{9})[A-Za-z0-9_-]{42}", re.ASCII)
"""Worker, Unix time, a random text of 22 characters, and the HMAC of it all."""

MAX_TOKEN_AGE_S = 86_400
"""Age at which a token can no longer continue a play, seconds."""

_MAC_CHARS = 20


def make_token(number: int, secret: bytes, now_s: float) -> str:
    """A new token of a play in worker `number`; it cannot be guessed. secret: the server's; now_s:
    Unix time."""
    text = f"{number}-{int(now_s):09x}{secrets.token_urlsafe(16)}"
    return text + _mac(text, secret)


def is_issued(token: str, secret: bytes, now_s: float) -> bool:
    """Whether `make_token` made `token` with this secret, in any worker, within MAX_TOKEN_AGE_S."""
    if not _TOKEN.fullmatch(token):
        return False
    is_ours = hmac.compare_digest(_mac(token[:-_MAC_CHARS], secret), token[-_MAC_CHARS:])
    return is_ours and now_s < issue_time_s(token) + MAX_TOKEN_AGE_S


def issue_time_s(token: str) -> int:
    """When `make_token` made `token`, which `is_issued`: Unix time."""
    match = _TOKEN.fullmatch(token)
    assert match is not None
    return int(match[2], 16)


def worker_of(token: str) -> int | None:
    """The worker that made `token`; None where none can have."""
    match = _TOKEN.fullmatch(token)
    return int(match[1]) if match else None


def _mac(text: str, secret: bytes) -> str:
    digest = hmac.digest(secret, text.encode(), "sha256")
    return urlsafe_b64encode(digest).decode()[:_MAC_CHARS]


SHARED_MEMORY: Final = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
"""Where files are memory; None where there is no such folder."""

FOLDER_PREFIX: Final = "swings-serve-"

LOCK: Final = ".lock"


class WorkerFolder:
    """The folder of one server's workers: their sockets, and the files of their metrics. It belongs
    to the process that makes it and to those that it forks.

    A lock that ends with these processes holds it, so that what killed servers left is known. It
    lies in memory where there is such a place: a disk may be full, or cleared by age, and a page of
    a mapped file that cannot be stored ends its process.
    """

    def __init__(self, place: str | None = SHARED_MEMORY) -> None:
        """place: the folder for it; None for that of temporary files."""
        root = Path(place or tempfile.gettempdir())
        for other in root.glob(f"{FOLDER_PREFIX}*"):
            _remove_dead(other)
        self.path = Path(tempfile.mkdtemp(prefix=FOLDER_PREFIX, dir=root))
        self._lock = os.open(self.path / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
        fcntl.flock(self._lock, fcntl.LOCK_EX)

    def make(self) -> None:
        """Makes the folder again if it is gone."""
        self.path.mkdir(mode=0o700, exist_ok=True)

    def is_first(self, what: str) -> bool:
        """Whether no process of the server has asked so before."""
        try:
            os.close(os.open(self.path / what, os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return False
        return True

    def remove(self) -> None:
        shutil.rmtree(self.path, ignore_errors=True)


def _remove_dead(folder: Path) -> None:
    """Removes the folder of a server that has died; of one that lives, or of others, nothing."""
    with suppress(OSError), open(folder / LOCK, "rb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder)


MAX_WORKERS = 256

MIN_WORKER_TIMEOUT_S = 2
"""Below it a heartbeat that is a little late would end a worker."""


@dataclass(frozen=True, slots=True)
class SupervisorConfig:
    """Number, shutdown and heartbeat of the worker processes."""

    workers: int = 1
    """Number of worker processes; use one for each core that is to serve."""
    shutdown_timeout_s: float = 10.0
    """Seconds that workers have to shut down before they are killed."""
    worker_timeout_s: int = 15
    """With two or more workers: seconds without a heartbeat of its event loop after which a worker
    is killed and replaced."""

    def __post_init__(self) -> None:
        if not 1 <= self.workers <= MAX_WORKERS:
            raise InvalidError(f"workers is {self.workers}; give 1 to {MAX_WORKERS}")
        if self.workers > 1 and sys.platform == "win32":
            raise InvalidError(f"workers is {self.workers}; Windows allows only 1; give 1")
        if not 0 < self.shutdown_timeout_s < math.inf:
            raise InvalidError(
                f"shutdown_timeout_s is {self.shutdown_timeout_s}; it must be positive"
            )
        if self.worker_timeout_s < MIN_WORKER_TIMEOUT_S:
            raise InvalidError(
                f"worker_timeout_s is {self.worker_timeout_s}; give {MIN_WORKER_TIMEOUT_S} or more"
            )
