"""A stream's files from whichever of its hosts has them.

Rule: what has come of a file is not asked for again; a host that fails is left for the next one.
"""

from __future__ import annotations

import random
import re
import time
from contextlib import closing
from dataclasses import dataclass, field

from codec.stream.manifest import MANIFEST_NAME

from .faults import BrokenError, FetchError, MissingError
from .fetch import Asked, Fetcher, OpenResponse, Response
from .hosts import joined
from .idle import IdleLimit
from .retry import Retry, RetryConfig

PROGRESS_BYTES = 4096
"""A try that brought less has brought nothing: or who sends byte after byte is waited for."""


@dataclass(slots=True)
class Found:
    """A file, or what has come of it."""

    url: str = ""
    data: bytearray = field(default_factory=bytearray)
    tag: str = ""
    """What the host at `url` calls this content; empty if it does not say."""
    pieced: bool = False
    """Whether it came in several answers: they may be of different contents."""


class Mirrors:
    """The same files below several URLs, of which one is asked at a time."""

    def __init__(self, bases: tuple[str, ...], fetcher: Fetcher, retry: RetryConfig) -> None:
        """bases: each ends with a slash."""
        self._bases = bases
        self._fetcher = fetcher
        self._retry = retry
        self._at = 0

    def url(self, reference: str) -> str:
        """Where the file is that `reference` names, relative to the manifest. Raises FetchError."""
        base = self._bases[self._at] + MANIFEST_NAME
        return joined(base, reference, self._fetcher.config.other_hosts)

    def get(self, reference: str, limit_bytes: int) -> Found:
        """The file that `reference` names; see `url`. Raises FetchError."""
        tries, found = _Tries(self, self._retry), Found()
        while True:
            before, at = len(found.data), self._at
            try:
                self._read(self.url(reference), limit_bytes, found)
                return found
            except FetchError as error:
                tries.failed(error, at, len(found.data) - before)

    def span(self, reference: str, first_byte: int, end_byte: int, file_bytes: int) -> Span:
        """Bytes first_byte..end_byte-1 of a file of `file_bytes`, which are asked for at once, and
        read later. Close it."""
        return Span(self, _Tries(self, self._retry), reference, (first_byte, end_byte), file_bytes)

    def _wait(self, retry: Retry, error: BrokenError) -> None:
        self._fetcher.pause(retry.delay_s(error, time.monotonic(), random.random()))

    def _read(self, url: str, limit_bytes: int, found: Found) -> None:
        """Adds to `found` what is missing."""
        asked = {}
        if found.data:
            asked["Range"] = f"bytes={len(found.data)}-"
            if found.tag and found.url == url:
                asked["If-Range"] = found.tag
        with closing(self._fetcher.open(url, asked)) as response:
            if response.status == 206 and found.data:
                if range_start(response) != len(found.data):
                    found.data.clear()
                    raise BrokenError(f"{url}: it answers another range than was asked for")
                found.pieced = True
            elif response.status == 200:
                found.data.clear()
                found.pieced = False
            else:
                found.data.clear()
                raise refusal(url, response)
            found.url, found.tag = url, strong_tag(response)
            for piece in response.pieces():
                found.data += piece
                if len(found.data) > limit_bytes:
                    raise FetchError(f"{url} is longer than {limit_bytes} bytes")

    def tail(self, reference: str, first_byte: int, limit_bytes: int) -> bytes:
        """What the file has from `first_byte` on, which may be nothing. Raises FetchError."""
        retry = Retry(self._retry)
        while True:
            url = self.url(reference)
            try:
                with closing(
                    self._fetcher.open(url, {"Range": f"bytes={first_byte}-"})
                ) as response:
                    if response.status == 416:
                        return b""
                    if response.status == 206 and range_start(response) == first_byte:
                        return response.rest(limit_bytes)
                    if response.status == 200:
                        return response.rest(limit_bytes)[first_byte:]
                    raise refusal(url, response)
            except BrokenError as error:
                self._at = (self._at + 1) % len(self._bases)
                self._wait(retry, error)


class _Tries:
    """What fails while one file is fetched, and who is asked for it next."""

    def __init__(self, mirrors: Mirrors, retry: RetryConfig) -> None:
        self._mirrors = mirrors
        self._retry = Retry(retry)
        self._silent = self._missing = 0  # hosts in a row

    def failed(self, error: FetchError, at: int, num_bytes: int) -> None:
        """Host number `at` has failed after `num_bytes` new bytes. Turns to the next one, after a
        while if all have failed. Raises FetchError when there is no hope."""
        mirrors, num_hosts = self._mirrors, len(self._mirrors._bases)
        self._silent += 1
        if isinstance(error, BrokenError):
            if num_bytes >= PROGRESS_BYTES:
                self._retry.progress()
            if self._silent == num_hosts:
                mirrors._wait(self._retry, error)
        else:
            self._missing += 1
            if self._missing == num_hosts:
                raise error
        if self._silent == num_hosts:
            self._silent = self._missing = 0
        if mirrors._at == at:  # else another request has turned away from it
            mirrors._at = (at + 1) % num_hosts


@dataclass(frozen=True, slots=True)
class SpanPiece:
    """Some bytes of a file."""

    first_byte: int
    data: bytes


class Span:
    """A run of bytes of a file: asked for when it is made, read piece by piece. What breaks off is
    asked for again from the byte that is missing."""

    def __init__(
        self,
        mirrors: Mirrors,
        tries: _Tries,
        reference: str,
        span: tuple[int, int],
        file_bytes: int,
    ) -> None:
        self._mirrors, self._tries, self._reference = mirrors, tries, reference
        self._at_byte, self._end_byte = span
        self._reached_byte = self._at_byte  # by the tries before
        self._file_bytes = file_bytes
        self.is_whole = span == (0, file_bytes)
        """Whether the whole file comes: it was asked for, or the host knows no ranges."""
        self.url = ""
        """Of the host that is asked."""
        self._asked: Asked | None = None
        self._response: OpenResponse | None = None
        self._ask()

    def _ask(self) -> None:
        mirrors, fields = self._mirrors, {}
        self._host = mirrors._at
        self.url = mirrors.url(self._reference)
        if (self._at_byte, self._end_byte) != (0, self._file_bytes):
            fields["Range"] = f"bytes={self._at_byte}-{self._end_byte - 1}"
        self._asked = mirrors._fetcher.ask(self.url, fields)
        self._reached_byte = max(self._reached_byte, self._at_byte)
        self._read_s = 0.0
        # Only the time counts in which somebody waits for it.
        self._idle = IdleLimit(mirrors._fetcher.config.idle_s, 0.0)

    def read(self, timeout_s: float) -> SpanPiece | None:
        """The next bytes, none at the end; None if nothing came in time. Raises FetchError."""
        began_s = time.monotonic()
        try:
            return self._read(timeout_s)
        except FetchError as error:
            self.close()
            self._tries.failed(error, self._host, self._at_byte - self._reached_byte)
            self._ask()
            return None
        finally:
            self._read_s += time.monotonic() - began_s

    def _read(self, timeout_s: float) -> SpanPiece | None:
        at = self._at_byte
        if at == self._end_byte:
            return SpanPiece(at, b"")
        left_s = self._idle.left_s(self._read_s)
        if not left_s:
            raise BrokenError(f"{self.url}: {self._idle.reason(self._read_s)}")
        timeout_s = min(timeout_s, left_s)
        if self._response is None:
            assert self._asked is not None
            self._response = self._asked.answer(timeout_s)
            if self._response is None:
                return None
            self._check(self._response)
            at = self._at_byte
        data = self._response.read(timeout_s)
        if data is None:
            return None
        if not data:
            raise BrokenError(f"{self.url}: it ended early")
        if at + len(data) > self._end_byte:
            raise FetchError(f"{self.url}: more bytes came than were asked for")
        self._idle.received(len(data))
        self._at_byte = at + len(data)
        return SpanPiece(at, data)

    def _check(self, response: OpenResponse) -> None:
        """Looks whether it is an answer to what was asked for."""
        if response.status == 206:
            total = range_total(response)
            if range_start(response) != self._at_byte:
                raise BrokenError(f"{self.url}: it answers another range than was asked for")
        elif response.status == 200:
            length = response.headers.get("Content-Length", "")
            known = length.isascii() and length.isdecimal() and len(length) <= 18
            total = int(length) if known else None
            self._at_byte, self._end_byte, self.is_whole = 0, self._file_bytes, True
        else:
            raise refusal(self.url, response)
        if total not in (None, self._file_bytes):
            raise FetchError(f"{self.url}: {total} bytes, the index says {self._file_bytes}")

    def close(self) -> None:
        """Drops what was not read, and the connection with it."""
        if self._asked is not None:
            self._asked.close()
        self._asked = self._response = None


def refusal(url: str, response: Response | OpenResponse) -> FetchError:
    """The error for an answer that is not the file."""
    message = f"{url}: HTTP {response.status}"
    if response.status >= 500 or response.status in (408, 416, 429):
        return BrokenError(message, response.retry_after_s)
    if response.status in (404, 410):
        return MissingError(message)
    return FetchError(message)


def range_start(response: OpenResponse) -> int | None:
    """The byte that an answer of 206 begins with; None if it does not say."""
    found = re.match(r"bytes (\d{1,18})-", response.headers.get("Content-Range", ""))
    return int(found[1]) if found else None


def range_total(response: OpenResponse) -> int | None:
    """The size of the file that an answer of 206 is a range of; None if it does not say."""
    found = re.fullmatch(r"bytes [\d-]{1,40}/(\d{1,18})", response.headers.get("Content-Range", ""))
    return int(found[1]) if found else None


def strong_tag(response: OpenResponse) -> str:
    """What If-Range takes; empty if the answer has none."""
    tag = response.headers.get("ETag", "")
    if tag and not tag.startswith("W/"):
        return tag
    return response.headers.get("Last-Modified", "")
