"""HTTP for one thread that may block: an event loop that runs only while a caller waits; and how
soon, and for how long, a broken connection is tried again.

Rule: whatever goes wrong on the network leaves here as one of the errors below. Nothing is read
ahead of its reader, so a player that is busy holds the server back.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Coroutine, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from email.utils import parsedate_to_datetime
from typing import Any, TypeVar
from urllib.parse import urlsplit

from codec.errors import InvalidError

from .http import Answer, HttpPool, IdleLimit
from .target import BrokenError, HostError, Origin, Target, joined
from .target import FetchError as FetchError
from .target import StoppedError as StoppedError


@dataclass(frozen=True, slots=True)
class RetryConfig:
    """Patience with a server that fails."""

    patience_s: float = 60.0
    """Seconds of tries that bring nothing after which the player gives up; 0: at once."""
    first_delay_s: float = 0.1
    """Before the first new try, seconds; doubled each time."""
    max_delay_s: float = 2.0
    """Longest wait between two tries, seconds, unless the server asks for a longer one."""

    def __post_init__(self) -> None:
        if not 0 <= self.patience_s <= 86400:
            raise InvalidError(f"patience {self.patience_s} s is not within 0..86400 s")


class Retry:
    """The failures since something of use came last."""

    def __init__(self, config: RetryConfig) -> None:
        self._config = config
        self._failures = 0
        self._since_s = 0.0

    def progress(self) -> None:
        """Something of use came: what failed before is forgotten."""
        self._failures = 0

    def delay_s(self, error: BrokenError, now_s: float, chance: float) -> float:
        """How long to wait before the next try. chance: 0 to 1, so that not all clients come back
        at the same moment. Raises BrokenError when the patience is over."""
        config = self._config
        if not self._failures:
            self._since_s = now_s
        tried_s = now_s - self._since_s
        left_s = config.patience_s - tried_s
        self._failures += 1
        if left_s <= 0:
            tried = f" (tried for {tried_s:.3g} s, {self._failures} times)" if tried_s else ""
            raise BrokenError(f"{error}{tried}")
        delay_s = min(config.first_delay_s * 2.0 ** min(self._failures - 1, 60), config.max_delay_s)
        delay_s *= 0.5 + 0.5 * chance
        # The last try is at the end of the patience, whatever the server asks for.
        return min(max(delay_s, error.retry_after_s or 0.0), left_s)


Result = TypeVar("Result")

REDIRECTS = (301, 302, 303, 307, 308)

MAX_REDIRECTS = 5


@dataclass(frozen=True, slots=True)
class FetchConfig:
    """Patience with a server, and where it may lead."""

    connect_timeout_s: float = 10.0
    """Seconds to wait for a connection, and as many for TLS over it."""
    idle_s: float = 75.0
    """Seconds to wait for an answer, and for anything of use in it: longer than a server of a live
    stream waits for a segment."""
    other_hosts: bool = False
    """Whether redirects to other hosts are followed."""


class Fetcher:
    """Requests over persistent connections, for one reader that waits for one at a time.

    `interrupt` may come from any thread, everything else from one thread at a time.
    """

    def __init__(
        self,
        via: tuple[str, int] | None = None,
        config: FetchConfig | None = None,
        received: Callable[[int], None] | None = None,
        pool: HttpPool | None = None,
        logins: Mapping[Origin, str] | None = None,
    ) -> None:
        """via: address of a relay that every request goes through instead of to its host.
        received: called with the number of bytes of each read of a body. pool: of another Fetcher,
        which closes it; without it there is one of its own. logins: see `logins_of`."""
        self._via = via
        self.config = config or FetchConfig()
        self._logins = logins or {}
        self._owns = pool is None
        self._pool = pool or HttpPool(self.config.connect_timeout_s, via)
        self._loop = self._pool.loop
        self._lock = threading.Lock()
        self._waiting: asyncio.Task[Any] | None = None
        self._stopped = False
        self._news = asyncio.Event()
        self._received = received
        self.received_bytes = 0
        """Bytes of bodies read so far."""

    def get(self, url: str, limit_bytes: int) -> Response:
        """The answer to a GET, whatever its status.

        Raises FetchError when the body is longer than `limit_bytes`, BrokenError when it does not
        come whole.
        """
        with closing(self.open(url)) as response:
            response.body = response.rest(limit_bytes)
        return response

    def open(self, url: str, headers: Mapping[str, str] | None = None) -> Response:
        """The answer to a GET, its body yet to be read. Close it."""
        return self._run(self._open(url, headers), url)

    def ask(self, url: str, headers: Mapping[str, str], limit_bytes: int) -> Asked:
        """A GET that is read in the background whenever the caller waits on this fetcher, see
        `wait`. Several may run at a time. Close it."""
        return Asked(self, url, headers, limit_bytes)

    def wait(self, timeout_s: float) -> None:
        """Returns when bytes of any `ask` have arrived, or after `timeout_s`."""
        self._run(self._wait(timeout_s), "")

    async def _wait(self, timeout_s: float) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                await self._news.wait()
        self._news.clear()

    async def _open(self, url: str, headers: Mapping[str, str] | None) -> Response:
        for _ in range(MAX_REDIRECTS):
            answer = await self._request(url, headers=headers)
            place = answer.headers.get("Location")
            if answer.status not in REDIRECTS or place is None:
                return Response(self, url, answer)
            await answer.close()
            url = joined(url, place, self.config.other_hosts)
            if self._via is not None and urlsplit(url).scheme != "http":
                raise FetchError(f"{url}: --link works only with http:// URLs")
        raise FetchError(f"{url}: more than {MAX_REDIRECTS} redirects")

    def post(self, url: str, body: bytes) -> Response:
        """The answer to a POST, without its body, which is not read."""
        return self._run(self._post(url, body), url)

    def shared(self) -> Fetcher:
        """One more over the same connections, interrupted and counted by itself. One of them is
        used at a time. Close it before this one."""
        return Fetcher(self._via, self.config, self._received, self._pool, self._logins)

    def another(self, config: FetchConfig) -> Fetcher:
        """Another fetcher by the same route, for another thread. Close it."""
        return Fetcher(self._via, config, logins=self._logins)

    def interrupt(self) -> None:
        """Makes a caller that waits, now or later, raise StoppedError."""
        with self._lock:
            self._stopped = True
            if self._waiting is not None:
                self._loop.call_soon_threadsafe(self._waiting.cancel)

    def count(self, num_bytes: int) -> None:
        """So many bytes of a body were read."""
        self.received_bytes += num_bytes
        if self._received is not None:
            self._received(num_bytes)

    def pause(self, seconds: float) -> None:
        """Waits, unless interrupted."""
        self._run(asyncio.sleep(seconds), "")

    def close(self) -> None:
        """Closes all connections that are its own; closing twice is the same as once."""
        if self._owns:
            self._pool.close()

    def _run(self, work: Coroutine[Any, Any, Result], url: str) -> Result:
        with self._lock:
            if self._stopped:
                work.close()
                raise StoppedError(f"{url}: stopped")
            task: asyncio.Task[Result] = self._loop.create_task(work)
            self._waiting = task
        try:
            with translated(url):
                return self._loop.run_until_complete(task)
        except asyncio.CancelledError as error:
            raise StoppedError(f"{url}: stopped") from error
        except BaseException:
            # An interrupt from the keyboard leaves the task waiting: end it before the loop closes.
            if not task.done():
                task.cancel()
                self._loop.run_until_complete(asyncio.gather(task, return_exceptions=True))
            raise
        finally:
            with self._lock:
                self._waiting = None

    async def _request(
        self,
        url: str,
        method: str = "GET",
        body: bytes | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> Answer:
        try:
            target = Target.of(url)
        except ValueError as error:
            raise FetchError(f"{url} is not a URL") from error
        if target.authorization is None:
            target = replace(target, authorization=self._logins.get(target.origin))
        # Also bounds an answer that begins again and again, or byte by byte.
        async with asyncio.timeout(self.config.idle_s):
            return await self._pool.request(method, target, headers or {}, body)

    async def _post(self, url: str, body: bytes) -> Response:
        answer = await self._request(url, "POST", body)
        await answer.close()
        return Response(self, url, answer)


@contextmanager
def translated(url: str) -> Iterator[None]:
    """Makes what goes wrong on the way to `url` one of our errors."""
    try:
        yield
    except HostError as error:
        kind = FetchError if error.is_final else BrokenError
        raise kind(f"{url}: {error}") from error
    except TimeoutError as error:
        raise BrokenError(f"{url}: the host did not answer in time") from error


class Asked:
    """A GET whose answer is read in the background whenever its fetcher waits for something."""

    def __init__(
        self, fetcher: Fetcher, url: str, headers: Mapping[str, str], limit_bytes: int
    ) -> None:
        self.url = url
        self.response: Response | None = None
        """None until it has begun."""
        self.pieces: deque[bytes] = deque()
        """Pieces of the body, in order of arrival; the caller removes them."""
        work = self._fetch(fetcher, headers, limit_bytes)
        self._task = fetcher._loop.create_task(work)

    async def _fetch(self, fetcher: Fetcher, headers: Mapping[str, str], limit_bytes: int) -> None:
        num_bytes = 0
        try:
            with translated(self.url):
                self.response = response = await fetcher._open(self.url, headers)
                idle = response._idle()
                while response.status in (200, 206) and (piece := await response._next(idle)):
                    num_bytes += len(piece)
                    response._check_length(num_bytes, limit_bytes)
                    self.pieces.append(piece)
                    fetcher._news.set()
        finally:
            fetcher._news.set()

    @property
    def ended(self) -> bool:
        """Whether no more pieces will come."""
        return self._task.done()

    @property
    def error(self) -> FetchError | None:
        """Why no more will come, where that is not the end."""
        failure = self._task.exception() if self._task.done() else None
        if failure is None or isinstance(failure, FetchError):
            return failure
        raise failure

    def close(self) -> None:
        """Drops what was not read, and the connection with it."""
        task = self._task
        if not task.done():
            task.cancel()
            task.get_loop().run_until_complete(asyncio.wait([task]))
        elif not task.cancelled():
            task.exception()  # marks it as retrieved
        if self.response is not None:
            self.response.close()


class Response:
    """An answer whose body is read piece by piece."""

    def __init__(self, fetcher: Fetcher, url: str, answer: Answer) -> None:
        self._fetcher = fetcher
        self._answer = answer
        self.url = url
        """Where redirects led."""
        self.status = answer.status
        self.headers = answer.headers
        self.content_type = self.headers.get("Content-Type", "")
        self.body = b""
        """The whole body, where `get` has read it."""

    def read(self, timeout_s: float) -> bytes | None:
        """The next piece of the body, empty at its end; None if nothing came in time. Raises
        BrokenError when it is cut off."""
        piece = self._fetcher._run(self._answer.piece(timeout_s), self.url)
        self._fetcher.count(len(piece or b""))
        return piece

    def pieces(self) -> Iterator[bytes]:
        """The rest of the body. Raises BrokenError when it comes too slowly."""
        idle = self._idle()
        while piece := self._fetcher._run(self._next(idle), self.url):
            yield piece

    def _idle(self) -> IdleLimit:
        return IdleLimit(self._fetcher.config.idle_s, time.monotonic())

    async def _next(self, idle: IdleLimit) -> bytes:
        """The next piece of the body, empty at its end. Raises BrokenError when `idle` is over."""
        while (left_s := idle.left_s(time.monotonic())) > 0:
            piece = await self._answer.piece(left_s)
            if piece is not None:
                idle.received(len(piece))
                self._fetcher.count(len(piece))
                return piece
        raise BrokenError(f"{self.url}: {idle.reason(time.monotonic())}")

    def rest(self, limit_bytes: int) -> bytes:
        """The rest of the body. Raises FetchError when it is longer than `limit_bytes`."""
        body = bytearray()
        for piece in self.pieces():
            body += piece
            self._check_length(len(body), limit_bytes)
        return bytes(body)

    def _check_length(self, num_bytes: int, limit_bytes: int) -> None:
        if num_bytes > limit_bytes:
            raise FetchError(f"{self.url} is longer than {limit_bytes} bytes")

    @property
    def retry_after_s(self) -> float | None:
        """How long the server asks to be left alone, seconds; None if it does not."""
        return parse_retry_after(self.headers.get("Retry-After", ""), time.time())

    def close(self) -> None:
        """Drops what was not read, and the connection with it."""
        self._fetcher._loop.run_until_complete(self._answer.close())


def parse_retry_after(text: str, unix_s: float) -> float | None:
    """The seconds that a Retry-After header says, which is a number or a date; None if neither."""
    if text.isascii() and text.isdecimal():
        return float(text[:9])
    try:
        date = parsedate_to_datetime(text)
    except ValueError:
        return None
    return max(0.0, date.timestamp() - unix_s)
